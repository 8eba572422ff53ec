"""Published planning problems, typed again, solved and judged: one folder a problem.

A folder has `problem.py` (the published formulation in CasADi), `scene.py` (the energies),
`own_equations.py` (the published equations as a scene), `steps.py` (the published time step),
`published.csv` (published parameters and results), `table.csv` (our table) and `README.md`.
"""
