"""Files of ours beside what others make of them, and there and back again."""
