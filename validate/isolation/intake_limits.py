"""How large an FMU may be that is let in."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class IntakeLimits:
    """Bytes unpacked altogether; entries; unpacked over packed, from a size on where it matters; bytes of one XML text."""

    unpacked: int = 2 * 1024**3
    entries: int = 20_000
    ratio: float = 100.0
    ratio_matters_from: int = 32 * 1024**2
    xml: int = 64 * 1024**2
