"""The exact contact problem by its contact modes: which contact pushes in which steps is searched, and what is left is solved exactly.

    mode sequence   = closed in [131, 179) for the left contact, in [276, 307) for the right one of
                    three carts
    cost of it      = the optimum of a smooth problem without any complementarity: a convex
                    quadratic program if the scene is linear

Softplus contact that grows sharper finds first modes, or relaxed complementarity does; `quadratic`
(or `nonlinear`) solves what is left with the modes fixed, `search` shifts, splits, merges, adds and
drops intervals until no neighbour is cheaper; `finder` says where modes come from, `starts` has
motions to start from, `session` opens `mpcc`. Complementarity is exactly zero in every plan: the
forces are k max(phi, 0) of the plan's own positions.
"""
