"""Multiple shooting: the states at the nodes are unknowns beside the inputs, and what a step misses the next node by is a gap to be closed.

solver     running and final cost with first and second derivatives, the goal as an augmented
           Lagrangian; the linear-quadratic subproblem (riccati.c: backward sweep with
           bounds on the inputs, forward sweep), steps, merit function and line search
method     the methods, opened on a scene

A step is run through the scene's own time step with the feedback of the subproblem, so that an
unstable scene stays near the plan. Neither Pyomo nor PyTorch is needed.
"""
