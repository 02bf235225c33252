"""Files that others read and write, as arrays: one module for each format, nothing of ours but
numpy.
"""
