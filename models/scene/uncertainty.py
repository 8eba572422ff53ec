"""How far from a scene the world may be where the scene does not say: shares, by which robustness is measured and robust plans are made.

Parameters a twentieth of their value (`Parameter(uncertainty=..)` says otherwise), the start a
hundredth of nominal, the gain of each input 2 %, noise of each input 1 % of its range, delay up to
one step.
"""

from __future__ import annotations

PARAMETER = 0.05
START = 0.01
GAIN = 0.02
NOISE = 0.01
DELAY = 1.0


def size_of(value: float, uncertainty: float | None) -> float:
    """How far from its value a parameter may be [its unit].

    0: it is certain. uncertainty: as stated, None: it is not.
    """
    return PARAMETER * abs(value) if uncertainty is None else uncertainty
