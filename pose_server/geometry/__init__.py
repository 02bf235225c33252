"""Arrays in, results out: no zenoh, no messages, no clocks."""
