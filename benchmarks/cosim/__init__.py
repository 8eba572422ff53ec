"""What it costs to simulate a scene as coupled FMUs, its contacts in FMUs of their own.

system.py loads and wires the FMUs of a split scene, masters.py are reference masters, libcosim.py
is somebody else's, study.py runs them all against the exact motion.
"""
