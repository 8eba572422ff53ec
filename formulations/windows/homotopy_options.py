"""Options of the softplus homotopy, for every method that reads contact modes off its stages."""

from __future__ import annotations

from formulations.method import OptionSpec

FIRST_SHARPNESS = OptionSpec(
    name="first_sharpness",
    default=7.0,
    description="sharpness of the first softplus stage, |ln eps|: b times the length that the scene counts it in",
    lower=1e-3,
    upper=700.0,
)
SHARPNESS_GROWTH = OptionSpec(name="sharpness_growth", default=2.0, description="factor between two stages", lower=1.01, upper=1e3)
HOMOTOPY_TOLERANCE = OptionSpec(
    name="homotopy_tolerance", default=1e-6, description="Ipopt's tol in the softplus stages", lower=1e-12, upper=1e-2
)
