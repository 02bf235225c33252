"""Files and folders as other people have them, made from numbers that are known."""
