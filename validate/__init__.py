"""Does it hold: campaigns, replay, score, and the command line `python -m validate`."""
