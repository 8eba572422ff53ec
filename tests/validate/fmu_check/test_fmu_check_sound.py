"""No false alarms: on our own FMUs, and on models of other kinds - events that change states, time events, no states, a fixed solver step."""

from collections.abc import Callable
from pathlib import Path

import pytest
from shell_fmu import FOREIGN, Foreign, build_shell

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.fmu_check import Status, check_fmu

# A scene of each kind: three_cart in both versions; without inertia; two with friction. Then three
# scenes of the tests: damped curved contacts with friction and a coupled mass matrix; friction with
# a load of its own; neither contacts nor inputs. A campaign makes the DECISIVE checks of every scene.
_SCENES = Path(__file__).parents[2] / "scenes"
_OWN = [
    *(("three_cart", version) for version in ("2.0", "3.0")),
    ("push_box", "3.0"),
    ("two_finger", "2.0"),
    ("hopper_planar", "3.0"),
    *(
        (str(_SCENES / f"{name}.py"), version)
        for name, version in (("damped_arm", "3.0"), ("drawer", "2.0"), ("oscillator", "3.0"))
    ),
]


def _alarms(report) -> list[str]:
    return [
        f"{row.name} ({row.type}): {row.sentence}"
        for row in report.rows
        if row.status is Status.FAILED
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "version"), _OWN, ids=lambda value: Path(value).stem if "/" in value else value
)
def test_no_alarm_on_our_own(scene: str, version: str):
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
            assert any(row.status is status and words in row.sentence for row in rows), [
                row.sentence for row in rows
            ]


# An output that may be read only while its clock ticks, which needs a scheduler.
_CLOCKED = (
    (
        "modelDescription.xml",
        "  <ModelVariables>\n",
        """  <ModelVariables>
    <Clock name="beat" valueReference="901" causality="input" intervalVariability="triggered"/>
    <Int32 name="sum" valueReference="905" causality="output" variability="discrete" initial="calculated" clocks="901"/>
""",
    ),
    (
        "modelDescription.xml",
        "  <ModelStructure>\n",
        '  <ModelStructure>\n    <Output valueReference="905"/>\n',
    ),
    (
        "sources/fmi3_absent.h",
        "NO_VARIABLES(Int32)\n",
        """fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, fmi3Int32 values[], size_t nValues)
{
    (void)vr, (void)nvr, (void)nValues;
    values[0] = 0;
    return ((Instance *)instance)->model.phase == PHASE_INITIALIZATION ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, const fmi3Int32 values[], size_t nValues)
{
    (void)instance, (void)vr, (void)nvr, (void)values, (void)nValues;
    return fmi3Error;
}
""",
    ),
)


@pytest.mark.slow
def test_clocked_variables_raise_no_alarm(defective: Callable[..., Path]):
    assert not _alarms(check_fmu(defective(_CLOCKED, "3.0")))
