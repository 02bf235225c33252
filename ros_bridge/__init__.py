"""The fleet's poses as ROS 2 has them: frames under `fleet`, poses and odometry, for RViz,
Foxglove, Nav2 and whoever else reads tf. No ROS is needed, but where `node` runs within it.
"""
