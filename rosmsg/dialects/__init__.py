"""How ROS 2 speaks on zenoh."""
