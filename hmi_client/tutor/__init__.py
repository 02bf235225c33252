"""What a learner sees of the tutor: a lesson's processes, advice, and the table at the end."""
