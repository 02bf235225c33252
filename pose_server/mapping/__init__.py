"""The fleet in 3D: the clouds of all located robots in one frame, with their cameras, as a file and
as a picture.
"""
