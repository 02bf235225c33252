"""How a process reaches the router: its configuration, its identity, and the session's opening."""
