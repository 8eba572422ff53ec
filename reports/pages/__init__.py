"""One file = what one page says, or pages that belong together: functions from a `Report` to a `Section`, or None where there is nothing to tell."""
