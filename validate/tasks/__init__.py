"""What a worker does - a run of a scene by a pipeline, a check - and the records of what it found."""
