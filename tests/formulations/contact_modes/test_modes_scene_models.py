"""Models that are used again give the numbers of models built anew, whatever they were used for before."""

from typing import cast

import pytest
from example_scenes import example_scene

import formulations.transcription.compiled
from formulations.contact_modes.session import MpccSession
from formulations.pipelines import load_method

ARM = example_scene("two_link_arm")  # nonlinear: its modes are solved by Ipopt


def opened(**options: object) -> MpccSession:
    return cast(MpccSession, load_method("mpcc").open(ARM, {"search": False, **options}))


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The models that were translated."""
    models: list[object] = []
    compile_model = formulations.transcription.compiled.compile_model
    monkeypatch.setattr(formulations.transcription.compiled, "compile_model", lambda model: (models.append(model), compile_model(model))[1])
    return models


@pytest.mark.slow
def test_the_fifth_start_is_the_start_alone(compiled: list[object]) -> None:
    several = opened(starts=5).solve(eps=None, warm_start=None, time_limit=600.0)
    built = len(compiled)
    assert built == 3, "two schedules of softplus, and the problem with modes fixed"
    fifth = several.starts[4]
    alone = opened(first_start=4).solve(eps=None, warm_start=None, time_limit=600.0)
    assert fifth.cost == alone.cost
    assert several.cost <= fifth.cost


@pytest.mark.slow
def test_another_radius_uses_the_same_models(compiled: list[object]) -> None:
    wide = opened(goal_tolerance=0.05)
    first = wide.solve(eps=None, warm_start=None, time_limit=600.0)
    built = len(compiled)
    second = wide.within(0.01).solve(eps=None, warm_start=first.trajectory, time_limit=600.0)
    assert len(compiled) == built
    assert first.residuals["terminal_error"] == pytest.approx(0.05, abs=1e-6)
    assert second.residuals["terminal_error"] == pytest.approx(0.01, abs=1e-6)
