"""Generate C from SymPy: one header per scene, shared by the shooting kernel and the FMUs."""
