"""What `hmi-client tutor` runs: a recording as a live fleet, and what a learner's points did."""
