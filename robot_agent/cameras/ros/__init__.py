"""Cameras of robots that run ROS 2, over zenoh, without ROS."""
