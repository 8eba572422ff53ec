"""Certify a point with the Pyomo model alone."""
