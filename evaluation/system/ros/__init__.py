"""Robots that run ROS 2, as stand-ins on zenoh: what it takes to have them in a fleet."""
