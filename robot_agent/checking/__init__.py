"""Whether a stereo rig is as its calibration says: rows, rotation, lengths."""
