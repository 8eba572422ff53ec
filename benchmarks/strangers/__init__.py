"""Scenes that are not in the bank: drawn by a seed, planned by the standard pipelines, judged.

    python -m benchmarks strangers --seed 1 --count 24

`families` writes scenes of eight kinds from drawn numbers. `draw` keeps a scene if random pushes
reach another end in a fine simulation, and makes that end the goal. `trial` plans and judges a
scene, and names the reason of each failure.
"""
