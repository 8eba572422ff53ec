"""Which variable of an FMU is what in a replay: value references only, so that it travels to a child process as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

# The outputs a replay can use beside positions and velocities; what an FMU lacks is computed from the scene or left out.
ENERGIES = ("kinetic_energy", "potential_energy", "contact_energy")
POWERS = ("input_power", "dissipated_power")
INTERNAL_STEP = "internal_step"


@dataclass(frozen=True, kw_only=True)
class Variables:
    """Value references. lam, gap and friction are empty where the FMU lacks one of them; v may be empty for an FMU without a scene.

    energies, powers: those the FMU has, by name; zero: names of energies and powers that the scene does not have at all;
    parameters: (reference, value) set before the start; start: references of what is set to the plan's start, in the order of the start
    vector; internal_step: of the Co-Simulation; choices: (reference, value) of whole numbers set before the start.
    """

    q: tuple[int, ...]
    v: tuple[int, ...]
    u: tuple[int, ...]
    lam: tuple[int, ...]
    gap: tuple[int, ...]
    energies: Mapping[str, int]
    powers: Mapping[str, int]
    zero: frozenset[str]
    parameters: tuple[tuple[int, float], ...]
    start: tuple[int, ...]
    internal_step: int | None
    choices: tuple[tuple[int, int], ...] = ()
    friction: tuple[int, ...] = ()

    @property
    def outputs(self) -> tuple[int, ...]:
        """Of all that is read at a point of the replay: q, v, lam, gap, friction, energies."""
        return self.q + self.v + self.lam + self.gap + self.friction + tuple(self.energies.values())

    @property
    def rates(self) -> tuple[int, ...]:
        """Of what is integrated beside the states: contact forces, powers."""
        return self.lam + tuple(self.powers.values())

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "zero": sorted(self.zero)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Variables:
        lists = {name: tuple(data[name]) for name in ("q", "v", "u", "lam", "gap", "friction", "start")}
        pairs = tuple((int(reference), float(value)) for reference, value in data["parameters"])
        choices = tuple((int(reference), int(value)) for reference, value in data["choices"])
        return cls(**{**data, **lists, "parameters": pairs, "choices": choices, "zero": frozenset(data["zero"])})
