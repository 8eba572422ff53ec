"""Contact phenomena with exact answers, for the truth suite (validate.cli.truth)."""
