"""What structure from motion leaves in files: photos with the points that each saw."""
