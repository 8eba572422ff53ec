"""What is true: scenes, their equations, trajectories, and the code generated from them.

    from models.catalog import load_scene
    from models.dynamics import derive

    scene = load_scene("three_cart")
    dynamics = derive(scene)
    dynamics.mass_matrix        # a SymPy matrix
    dynamics.absent             # what this scene does not need

This room imports nothing else of ours, and neither Pyomo nor PyTorch.
"""
