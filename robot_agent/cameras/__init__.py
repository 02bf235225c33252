"""Cameras, one file each, behind the protocol of `robot_agent.cameras.base`."""
