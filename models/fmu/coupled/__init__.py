"""Export a scene as coupled FMUs, one per body and contact, with their connections (SSP).

path = build_ssp(scene)  # all in one .ssp (System Structure and Parameterization 1.0)
parts = split(scene)
path = build_part(parts.contacts[0])
"""

from models.fmu.coupled.ssp import build_part, build_ssp, contact_table, split

__all__ = ["build_part", "build_ssp", "contact_table", "split"]
