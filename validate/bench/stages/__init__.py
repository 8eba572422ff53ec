"""Our stages: each function prepares, and hands back the work that is measured."""
