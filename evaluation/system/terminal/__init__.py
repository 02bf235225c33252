"""The operator's text client, used as its user does: in a terminal, by keys and by mouse."""
