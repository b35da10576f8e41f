"""The ROS 2 nodes: parameters, topics, services and conversion; no mathematics."""
