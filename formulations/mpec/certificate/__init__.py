"""The judge of a point: everything read from the Pyomo model again, by Pyomo's own means.

Nothing here knows how the point was found.
"""
