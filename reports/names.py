"""Names in records: verdicts that hold, and prefixes of metrics. Light to import: no pydantic."""

# Verdicts of plans that hold.
HOLD = ("holds", "holds with feedback")
# Prefix of metrics with feedback, as in validate.judge.score.
TRACKED = "tracked_"
# Prefix of metrics of the feedback's effort.
FEEDBACK = "feedback_"
