"""Judge a point by the Pyomo model alone, whoever computed the point."""
