"""Other simulators as judges.

ONE FILE = ONE ENGINE: `ENGINE = Simulator(..)`, whose arguments are literals, and `simulate(drive)
-> SimulatedMotion`.
"""
