"""What structure from motion leaves in files: views with the points that each saw."""
