"""What a robot that runs shows of its topics: which there are, and what it is called."""
