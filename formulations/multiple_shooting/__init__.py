"""Multiple shooting: the node states are unknowns too, and the gaps between steps are closed.

`solver` is the sequential linear-quadratic method with its costs, goal term and subproblem
(riccati.c), `method` its interface. Neither Pyomo nor PyTorch is needed.
"""
