"""Scenes, their equations, trajectories, and the code generated from them.

    scene = load_scene("three_cart")
    dynamics = derive(scene)
    dynamics.mass_matrix  # a SymPy matrix
    dynamics.absent  # list of features that the scene does not need

This package imports no other room, and neither Pyomo nor PyTorch.
"""
