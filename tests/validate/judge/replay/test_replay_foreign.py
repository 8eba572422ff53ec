"""FMUs that offer less than ours: one kind only, no contact outputs, no energies, no interpolation of inputs. Made by editing the XML of ours."""

import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from edited_fmu import edited, renamed, without

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.fmi.description import FmuError
from validate.judge.judgement import wire_fmu
from validate.judge.replay import Replay, ReplayOutcome
from validate.judge.replay.run import replay
from validate.judge.replay.subject import find_variables
from validate.judge.score import score

STEPS = 60


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_cart").with_task(steps=STEPS, start=(2.0, 2.52, 3.05, 0.5, 0.0, -0.5))


@pytest.fixture(scope="module")
def fmu() -> Path:
    return build_fmu(load_scene("three_cart"))


def make_plan(scene: Scene, hold: Hold = Hold.ZERO_ORDER) -> Trajectory:
    u = np.column_stack([np.linspace(2, -2, STEPS), np.linspace(-1, 1, STEPS)])
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, 0.01)
    return Trajectory(
        t=uniform_grid(0.01, STEPS), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, hold=hold
    )


@pytest.fixture(scope="module")
def whole(scene: Scene, fmu: Path) -> Replay:
    return replay(scene, fmu, make_plan(scene))


def test_without_model_exchange_the_everyday_replay_is_judged(
    tmp_path: Path, scene: Scene, fmu: Path, whole: Replay
):
    result = replay(
        scene, edited(fmu, tmp_path / "cs.fmu", without("ModelExchange")), make_plan(scene)
    )
    assert (result.outcome, result.method) == (ReplayOutcome.OK, "everyday")
    assert "no Model Exchange" in result.message
    assert result.error.estimate is not None
    assert result.error.estimate.position >= result.error.step.position
    assert result.error.tolerance is None
    assert result.q == pytest.approx(whole.q[whole.knots], abs=1e-10)
    assert (result.input_work, result.contact_impulse) == (None, None)
    metric = score(scene, make_plan(scene), result).metric("energy_residual_relative")
    assert metric.value is None
    assert "input_power" in metric.reason


def test_without_cosimulation_the_reference_stands_alone(
    tmp_path: Path, scene: Scene, fmu: Path, whole: Replay
):
    result = replay(
        scene, edited(fmu, tmp_path / "me.fmu", without("CoSimulation")), make_plan(scene)
    )
    assert (result.outcome, result.method) == (ReplayOutcome.OK, "reference")
    assert "No everyday replay: the FMU offers no Co-Simulation." in result.message
    assert result.error.estimate == result.error.tolerance
    assert result.error.everyday is None
    assert result.q.tobytes() == whole.q.tobytes()


def test_what_the_fmu_does_not_put_out_comes_from_the_scene(
    tmp_path: Path, scene: Scene, fmu: Path, whole: Replay
):
    hide = renamed(
        "lam_left",
        "lam_right",
        "gap_left",
        "gap_right",
        "kinetic_energy",
        "contact_energy",
        "input_power",
        "dissipated_power",
    )
    result = replay(scene, edited(fmu, tmp_path / "bare.fmu", hide), make_plan(scene))
    assert result.ok, result.message
    plan_nodes, whole_nodes = result.knots, whole.knots
    for field in ("q", "lam", "gap", "kinetic_energy", "contact_energy"):
        assert getattr(result, field)[plan_nodes] == pytest.approx(
            getattr(whole, field)[whole_nodes], abs=1e-8
        )
    assert result.input_work is None
    assert result.contact_impulse is None
    assert score(scene, make_plan(scene), result).value("ghost_impulse") == pytest.approx(
        score(scene, make_plan(scene), whole).value("ghost_impulse"), abs=1e-9
    )


def test_without_an_internal_step_the_communication_step_is_halved(
    tmp_path: Path, scene: Scene, fmu: Path
):
    result = replay(
        scene, edited(fmu, tmp_path / "fixed.fmu", renamed("internal_step")), make_plan(scene)
    )
    assert result.error.step is not None
    assert result.error.everyday.position < 1e-9


def test_ramps_become_stairs_for_an_fmu_that_holds_its_inputs(
    tmp_path: Path, scene: Scene, fmu: Path
):
    holding = edited(
        fmu,
        tmp_path / "hold.fmu",
        lambda text: text.replace('canInterpolateInputs="true"', 'canInterpolateInputs="false"'),
    )
    ramped, exact = (
        replay(scene, holding, make_plan(scene, Hold.LINEAR)),
        replay(scene, fmu, make_plan(scene, Hold.LINEAR)),
    )
    # Stairs at a hundredth of the step, wrong by their square: far above the integrator's own
    # error, far below what the hold makes.
    assert 10 * exact.error.everyday.position < ramped.error.everyday.position < 1e-6
    coarser = replay(scene, holding, make_plan(scene, Hold.LINEAR), fineness=(50, 100))
    ratio = coarser.error.step.position / ramped.error.step.position
    assert ratio == pytest.approx(4.0, rel=0.05)
    assert ramped.q.tobytes() == exact.q.tobytes()


def test_steps_of_different_length_are_not_given_to_an_fmu_that_wants_equal_ones(
    tmp_path: Path, scene: Scene, fmu: Path
):
    word = 'canHandleVariableCommunicationStepSize="true"'
    equal = edited(
        fmu, tmp_path / "equal.fmu", lambda text: text.replace(word, word.replace("true", "false"))
    )
    plan = make_plan(scene)
    t = plan.t.copy()
    t[10] += 0.003
    uneven = Trajectory(t=t, q=plan.q, v=plan.v, u=plan.u, lam=plan.lam)
    result = replay(scene, equal, uneven)
    assert (result.method, result.error.everyday) == ("reference", None)
    assert "differ in length" in result.message
    assert replay(scene, fmu, uneven).error.everyday is not None
    with pytest.raises(FmuError, match=r"no Model Exchange, .*steps differ"):
        replay(scene, edited(equal, tmp_path / "only.fmu", without("ModelExchange")), uneven)


def test_a_binary_that_does_not_load_is_named(tmp_path: Path, scene: Scene, fmu: Path):
    broken = tmp_path / "broken.fmu"
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(broken, "w") as new:
        for item in old.infolist():
            new.writestr(
                item, b"no library" if item.filename.startswith("binaries/") else old.read(item)
            )
    before = Path.cwd()
    with pytest.raises(FmuError, match=r"broken\.fmu: it cannot be loaded"):
        replay(scene, broken, make_plan(scene))
    assert Path.cwd() == before  # FMPy leaves the process in a folder that no longer exists


# Which variables of an FMU are those of a scene


def described(names: dict[str, tuple[int, str]], kind: str = "Real") -> Any:
    """An FMU of such variables: name -> (reference, causality)."""
    items = [
        SimpleNamespace(name=name, valueReference=reference, causality=causality, type=kind)
        for name, (reference, causality) in names.items()
    ]
    return SimpleNamespace(path=Path("a.fmu"), description=SimpleNamespace(modelVariables=items))


def named(scene: Scene) -> dict[str, tuple[int, str]]:
    """Every name that a replay uses, under a reference of its own."""
    groups = [
        [item.name for item in scene.coordinates],
        [item.velocity_name for item in scene.coordinates], [item.name for item in scene.inputs],
        [item.force_name for item in scene.contacts], [item.gap_name for item in scene.contacts],
        [item.force_name for item in scene.frictions],
        ["kinetic_energy", "potential_energy", "contact_energy"],
        ["input_power", "dissipated_power"], [item.name for item in scene.parameters],
        ["internal_step"],
    ]  # fmt: skip
    inputs = {item.name for item in scene.inputs}
    parameters = {item.name for item in scene.parameters}
    return {
        name: (100 * place + index,
               "input" if name in inputs else "parameter" if name in parameters else "output")
        for place, group in enumerate(groups) for index, name in enumerate(group)
    }  # fmt: skip


def test_every_variable_of_a_scene_is_found_by_its_name():
    scene = load_scene("transport")
    found = find_variables(described(named(scene)), scene)
    assert (found.q, found.v, found.u) == (tuple(range(2)), (100, 101), (200,))
    assert (found.lam, found.gap, found.friction) == (
        tuple(300 + i for i in range(scene.nc)), tuple(400 + i for i in range(scene.nc)),
        tuple(500 + i for i in range(scene.nf)),
    )  # fmt: skip
    assert (dict(found.energies), dict(found.powers)) == (
        {"kinetic_energy": 600, "potential_energy": 601, "contact_energy": 602},
        {"input_power": 700, "dissipated_power": 701},
    )
    assert found.parameters == tuple(
        (800 + index, item.value) for index, item in enumerate(scene.parameters)
    )
    assert (found.start, found.internal_step, found.choices) == ((0, 1, 100, 101), 900, ())


@pytest.mark.parametrize(
    ("name", "zero"),
    [
        ("three_cart", {"potential_energy"}),
        ("bouncing_mass", {"input_power", "dissipated_power"}),
        ("wall_pendulum", {"dissipated_power"}),
        ("transport", {"potential_energy"}),
    ],
)  # fmt: skip
def test_what_a_scene_does_not_have_is_zero(name: str, zero: set[str]):
    scene = load_scene(name)
    assert find_variables(described(named(scene)), scene).zero == zero


def test_what_an_fmu_lacks_of_a_group_leaves_the_group_out_or_is_refused(scene: Scene):
    whole = named(scene)
    some = {
        name: item
        for name, item in whole.items()
        if name not in ("lam_left", "gap_right", "input_power", "contact_energy", "internal_step")
    }
    found = find_variables(described(some), scene)
    assert (found.lam, found.gap, found.internal_step) == ((), (), None)
    assert (list(found.energies), list(found.powers)) == (
        ["kinetic_energy", "potential_energy"],
        ["dissipated_power"],
    )
    for name in ("q2", "v1", "u3"):
        with pytest.raises(
            FmuError, match=f"FMU a.fmu: .*no variable '{name}' of scene three_cart; give"
        ):
            find_variables(
                described({other: item for other, item in whole.items() if other != name}), scene
            )
    with pytest.raises(FmuError, match=r"u1 \(value reference 200\) is no input"):
        find_variables(described(whole | {"u1": (200, "output")}), scene)
    with pytest.raises(FmuError, match=r"q1 is of type Integer.*Real or Float64"):
        find_variables(described(whole, "Integer"), scene)
    first = scene.parameters[0].name
    assert (
        len(find_variables(described(whole | {first: (1, "local")}), scene).parameters)
        == len(scene.parameters) - 1
    )


@pytest.mark.parametrize("task", ["", "[task]\nduration = 1.0\n"])
def test_a_plan_of_few_rows_is_seen_as_often_as_any_other(tmp_path: Path, task: str):
    """A mass of 1 kg that falls 0.5 m turns at a depth d between two of six rows: m g (0.5 + d) = k d^2 / 2."""
    dropped = load_scene("bouncing_mass")
    m, g, k = (
        {item.name: item.value for item in dropped.parameters}[name] for name in ("m", "g", "k")
    )
    names = '[positions]\nq = "q"\n[contacts.floor]\nforce = "lam_floor"\ngap = "gap_floor"\ndepth = 0.5\n'
    (tmp_path / "map.toml").write_text(names + task, encoding="utf-8")
    t = np.linspace(0.0, 1.0, 6)
    judged = wire_fmu(
        build_fmu(dropped), {"t": t, "q": np.full(6, 0.5)}, map_path=tmp_path / "map.toml"
    ).judge()
    metric = judged.score.metric("max_penetration")
    assert metric is not None
    assert metric.value == pytest.approx(
        (m * g + np.sqrt((m * g) ** 2 + 2.0 * k * m * g * 0.5)) / k, abs=metric.error
    )
    assert metric.error < 1e-4
