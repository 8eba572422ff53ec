"""Plan and run campaigns: selection, campaign files, warnings, engines and tables."""
