"""What cameras out of bags and of live robots share: topics of ROS become frames."""
