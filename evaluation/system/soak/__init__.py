"""A fleet that runs for hours while its processes are killed, frozen and restarted."""
