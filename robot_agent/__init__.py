"""The robot: camera to points to the wire, and its pose back."""
