"""Other simulators: one file per engine, with `ENGINE = Simulator(..)` and `simulate(drive)`."""
