"""A pose server without network: its own site, jobs and solver, in one process."""
