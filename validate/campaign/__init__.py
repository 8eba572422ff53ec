"""What a campaign runs: selection, campaign files, and warnings before anything runs."""
