"""Rosbag2 bags without ROS: writing, reading, rescuing what a killed recorder left, and what a session was like."""
