"""Solve the exact contact problem: search the contact modes, solve the rest exactly.

    modes = closed in [131, 179) for the left contact, in [276, 307) for the right one of three
    carts

With fixed modes the problem is smooth without complementarity, and a convex QP for a linear scene
(`quadratic`, else `nonlinear`). `finder` gets first modes from softplus or relaxed contact,
`search` improves them interval by interval, `starts` provides start motions, `session` opens
`mpcc`.
"""
