"""A scene as several coupled FMUs: one for each body, one for each contact, and how they are connected (SSP).

    parts = split(scene)                 parts.bodies, parts.contacts, parts.connections
    path = build_part(parts.contacts[0]) the FMU of a part
    path = build_ssp(scene)              all FMUs and SystemStructure.ssd in one .ssp

This is how systems are split every day - the contact in a model of its own - and what that costs is measured by
`python -m benchmarks cosim`. Each body is a Scene of its own and goes through the exporter of scenes; a contact has no state, so its FMU is
algebraic: `contact.c` around generated functions.
"""

from models.fmu.coupled.contact import build_contact
from models.fmu.coupled.parts import Connection, ContactPart, Parts, split
from models.fmu.coupled.system import build_part, build_ssp

__all__ = ["Connection", "ContactPart", "Parts", "build_contact", "build_part", "build_ssp", "split"]
