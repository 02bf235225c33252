"""Cameras out of bags: ROS 1 and ROS 2, without ROS."""
