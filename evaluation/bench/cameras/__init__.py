"""`pose-eval cameras`: what is made of other people's cameras and files."""
