"""The exact contact problem by its contact windows: which contact pushes in which steps is searched, and what is left is solved exactly.

    windows  = [131, 179) for the left contact, [276, 307) for the right one of three carts
    cost(windows) = the optimum of a smooth problem without any complementarity: a convex quadratic program if the scene is linear

`homotopy` finds first windows by softplus contact that grows sharper, `quadratic` (or `nonlinear`) solves what is left with the modes fixed,
`moves` and `search` shift, split, merge, add and drop windows until no neighbour is cheaper, `stationarity` says what the multipliers
say. Complementarity is exactly zero in every plan: the forces are k max(phi, 0) of the plan's own positions.
"""
