"""Certify a point with only the Pyomo model."""
