"""Tasks of a worker, runs and checks, and their records."""
