"""The executive's state machine and the safety limits of the cell, without ROS."""
