"""Which of thousands of keyframes look like a new one: asked in milliseconds, whatever their
number.
"""
