"""No false alarms: on our own FMUs, and on models of other kinds - events that change states, time events, no states, a fixed solver step."""

from pathlib import Path

import pytest
from shell_fmu import FOREIGN, Foreign, build_shell

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.fmu_check import Status, check_fmu

_SCENES = Path(__file__).parents[2] / "scenes"
# A scene of each kind: contact of bodies and with walls, friction, damping, a mass matrix that couples, none of these. A full campaign checks them all.
_CATALOG = ("three_cart", "bouncing_mass", "damped_collision", "cart_pole_walls", "hopper_planar", "push_box", "two_discs_wall")
_OWN = [*_CATALOG, *(str(path) for path in sorted(_SCENES.glob("*.py")))]


def _alarms(report) -> list[str]:
    return [f"{row.name} ({row.type}): {row.sentence}" for row in report.rows if row.status is Status.FAILED]


@pytest.mark.slow
@pytest.mark.parametrize("scene", _OWN, ids=lambda scene: Path(scene).stem)
def test_no_alarm_on_our_own(scene: str):
    """Scenes take turns between the versions; three_cart, which most tests use, is checked in both."""
    versions = ("2.0", "3.0") if scene == "three_cart" else (("2.0", "3.0")[_OWN.index(scene) % 2],)
    for version in versions:
        report = check_fmu(build_fmu(load_scene(scene), version))
        assert report.types == ("ME", "CS")
        assert not _alarms(report)


@pytest.mark.slow
@pytest.mark.parametrize("model", FOREIGN, ids=lambda model: model.name)
def test_no_alarm_on_other_models(model: Foreign, tmp_path: Path):
    report = check_fmu(build_shell(model, tmp_path))
    assert not _alarms(report)
    for expected, status in ((model.expected, Status.PASSED), (model.untold, Status.NOT_OFFERED)):
        for name, words in expected:
            rows = [row for row in report.rows if row.name == name]
            assert any(row.status is status and words in row.sentence for row in rows), [row.sentence for row in rows]
