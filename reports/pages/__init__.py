"""Pages: functions from a `Report` to a `Section`, or None without content."""
