"""SymPy -> C: one header a scene, shared by the shooting kernel and the FMUs.

emit.emit_model(scene)          text of scene_model.h
kernel.load_kernel(scene)       the compiled time step and its adjoint, as numpy functions
"""
