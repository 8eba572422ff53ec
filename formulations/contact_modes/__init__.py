"""Solve the exact contact problem: search the contact modes, solve the rest exactly.

With fixed modes the problem is smooth without complementarity, and a convex QP for a linear scene
(`quadratic`, else `nonlinear`). `finder` gets first modes from softplus or relaxed contact,
`search` improves them, `starts` provides start motions, `session` opens `mpcc`.
"""
