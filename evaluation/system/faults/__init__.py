"""`pose-eval faults`: what is lost, and for how long, when processes are killed, frozen or slow."""
