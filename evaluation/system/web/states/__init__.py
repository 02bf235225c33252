"""The page in each of its states, of a real fleet: how it is brought there, and how it looks."""
