"""External FMUs: files, descriptions, instances over FMPy's classes, CVODE, loops in C."""
