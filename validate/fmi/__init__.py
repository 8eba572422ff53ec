"""External FMUs: files (archive), descriptions, instances over FMPy's classes, CVODE, loops in C."""
