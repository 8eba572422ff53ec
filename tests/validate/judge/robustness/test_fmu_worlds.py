"""Somebody's FMU in perturbed worlds: bit for bit those of the scene it was made of, first failures by hand, and what crashes or hangs costs its own world alone."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_fmu import (
    COSIMULATION,
    EXCHANGE,
    FULL_MAP,
    STIFFNESS,
    STOP,
    build_foreign,
    foreign_plan,
    write_plan,
)
from wording import unsaid

from models.catalog import load_scene
from models.errors import TouchstoneError
from models.fmu import build_fmu
from models.results.robustness import RobustnessRecord
from models.results.stored import from_json
from models.trajectory import write_csv
from validate.cli.group import run
from validate.judge.judgement import Judgement, WiredFmu, wire_fmu
from validate.judge.robustness import robustness
from validate.judge.robustness.trials import FmuArena, asked_limits
from validate.judge.robustness.worlds import moved, perturbations
from validate.processes.isolated import Limits

SCENE = load_scene("three_cart")
# A cart of 2 kg, thrown with 2 m/s and pushed with 4 N, before it meets the stop.
START = "[start]" + FULL_MAP.partition("[start]")[2].partition("[goal]")[0]
FREE = FULL_MAP.partition("[contacts.stop]")[0] + START + "[limits]\nreplay_error = 3e-4\n"
STEPS = 8
TIME = 0.08
FORCE = 4.0
MASS = 2.0
NEAR = 3e-4


@pytest.fixture
def free(tmp_path: Path) -> Callable[..., WiredFmu]:
    """A cart that misbehaves once it weighs so much, wired."""

    def wired(
        mode: str = "good", kinds: str = EXCHANGE + COSIMULATION, more: str = "", **how: Any
    ) -> WiredFmu:
        build_foreign(tmp_path / "cart.fmu", mode, kinds, defines=("BEYOND=2.02",))
        (tmp_path / "map.toml").write_text(FREE + more, encoding="utf-8")
        plan = write_plan(tmp_path / "plan.csv", "t,x,v_x,F", foreign_plan()[: STEPS + 1])
        return wire_fmu(tmp_path / "cart.fmu", plan, map_path=tmp_path / "map.toml", **how)

    return wired


def only_worlds(text: str) -> None:
    """Interrupted where the worlds have been tried."""
    if text.startswith("some of these"):
        raise KeyboardInterrupt


def scene_map() -> str:
    """The scene as a map says it."""
    parts = [
        "[inputs]",
        *(f'{item.name} = "{item.name}"' for item in SCENE.inputs),
        "[positions]",
        *(f'{item.name} = "{item.name}"' for item in SCENE.coordinates),
    ]
    parts += [
        "[velocities]",
        *(
            f'{item.name} = {{ variable = "{item.velocity_name}", column = "{item.velocity_name}" }}'
            for item in SCENE.coordinates
        ),
    ]
    for item, depth in zip(SCENE.contacts, SCENE.depths, strict=True):
        parts += [
            f"[contacts.{item.name}]",
            f'force = "{item.force_name}"',
            f'gap = "{item.gap_name}"',
            f"depth = {depth}",
        ]
    names = [item.name for item in SCENE.coordinates] + [
        item.velocity_name for item in SCENE.coordinates
    ]
    parts += [
        "[goal]",
        *(f"{name} = {value}" for name, value in zip(names, SCENE.task.goal, strict=True)),
        "[limits]",
    ]
    return "\n".join(
        [
            *parts,
            *(
                f"{limit.metric} = {limit.value}"
                for limit in SCENE.limits
                if limit.value is not None
            ),
        ]
    )


@pytest.mark.slow
def test_the_fmu_of_a_scene_fares_as_the_scene_does(judged: Judgement, tmp_path: Path):
    """As FMI 3.0 has it; the cart of the other tests is one of 2.0."""
    write_csv(tmp_path / "plan.csv", judged.plan, SCENE)
    (tmp_path / "map.toml").write_text(scene_map(), encoding="utf-8")
    wired = wire_fmu(
        build_fmu(SCENE, version="3.0"),
        tmp_path / "plan.csv",
        map_path=tmp_path / "map.toml",
    )
    seen: list[str] = []

    def enough(text: str) -> None:
        seen.append(text)
        if text.endswith("by itself"):
            raise KeyboardInterrupt

    own, other = (
        robustness(*subject, samples=40, seed=3, tell=enough)
        for subject in ((SCENE, judged.plan), (wired,))
    )
    assert [(item.name, item.size, item.nominal) for item in own.causes] == [
        (item.name, item.size, item.nominal) for item in other.causes
    ]
    assert (own.points == other.points).all()
    assert own.alone.tried == other.alone.tried
    assert (
        np.abs(np.array(own.feedback.tried) - np.array(other.feedback.tried)).max() < 0.02
    )  # its gains are made of the FMU's derivatives
    assert (other.alone.checked.by, other.alone.checked.differ) == ("by the reference", ())
    assert "some of these by the reference too" in seen


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [COSIMULATION, EXCHANGE + COSIMULATION])
def test_first_failures_are_those_of_the_closed_form(free: Callable[..., WiredFmu], kinds: str):
    wired = free(
        kinds=kinds, more="[uncertainty]\n'body.mass' = 0.2\n[accuracy]\nposition = 1e-6\n"
    )
    found = robustness(wired, samples=10, kinds=["body.mass", "gain", "start of x"])
    assert [(item.name, item.size, item.nominal, item.unit) for item in found.causes] == [
        ("body.mass", 0.2, 2.0, "kg"), ("start of x", 1e-5, 0.3, "m"),
        ("gain of F", 0.02, 1.0, "1"),
    ]  # fmt: skip
    pushed = FORCE / MASS * TIME**2 / 2.0  # x beyond that of a free flight
    expected = {
        ("body.mass", -1): MASS - MASS * pushed / (pushed + NEAR),
        ("body.mass", 1): MASS * pushed / (pushed - NEAR) - MASS,
        ("start of x", -1): NEAR, ("start of x", 1): NEAR, ("gain of F", -1): NEAR / pushed,
        ("gain of F", 1): NEAR / pushed,
    }  # fmt: skip
    for item in found.failures:
        assert item.amount == pytest.approx(
            item.direction * expected[item.cause.name, item.direction], rel=0.011
        ), item.cause.name
        assert item.by == "replay_error"
    mass, x, gain = (
        item.nominal + item.size * found.points[:, index] for index, item in enumerate(found.causes)
    )
    away = np.abs(x - 0.3 + gain * FORCE / mass * TIME**2 / 2.0 - pushed)
    assert np.array(found.alone.tried) == pytest.approx(away / NEAR, abs=0.002)
    assert 0 < found.alone.share.arrived < 10
    assert found.alone.checked.by == (
        "by the reference" if "Exchange" in kinds else "with half the smallest step"
    )


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize(
    ("mode", "word"),
    [("segfault", "crashed"), ("exit", "no_result"), ("fatal", "fatal"), ("nan", "not_a_number")],
)
def test_what_goes_wrong_in_a_world_costs_that_world(
    free: Callable[..., WiredFmu], mode: str, word: str
):
    found = robustness(free(mode), samples=10, kinds=["parameters"], tell=only_worlds)
    heavy = found.points[:, 0] * 0.1 + MASS >= 2.02
    assert 0 < heavy.sum() < 10
    assert not found.complete
    assert found.alone.fails_by.pop("replay_error", 0) == int(
        (np.array(found.alone.tried)[~heavy] > 1.0).sum()
    )
    assert found.alone.fails_by == {word: int(heavy.sum())}
    assert (np.isinf(np.array(found.alone.tried)) == heavy).all()


@pytest.mark.slow
@pytest.mark.process
def test_a_world_that_hangs_is_ended_at_the_limit_of_time(free: Callable[..., WiredFmu]):
    wired = free("hang", limits=Limits(seconds=2.0))
    mass = perturbations(wired.foreign.model, wired.plan, ["body.mass"])
    with FmuArena.of(wired, asked_limits(wired.judge().score)) as arena:
        trials = [
            arena.trial(moved(arena.nominal, mass, np.array([size]))) for size in (-0.5, 0.5, -0.5)
        ]
    assert [trial.fails_by for trial in trials[1:2]] == ["time_limit"]
    assert trials[0].ratio == trials[2].ratio < 1.0


@pytest.mark.parametrize(
    "kinds",
    [COSIMULATION, EXCHANGE + COSIMULATION, EXCHANGE, '<CoSimulation modelIdentifier="cart"/>'],
)
def test_a_contact_between_two_rows_is_seen_and_as_deep_as_the_closed_form_says(
    tmp_path: Path, kinds: str
):
    """A plan of one step: before it the cart is thrown, behind it it comes back from the stop."""
    build_foreign(tmp_path / "cart.fmu", kinds=kinds)
    limit = 0.103
    (tmp_path / "map.toml").write_text(
        FULL_MAP.replace("[start]", f"depth = {limit}\n[start]"), encoding="utf-8"
    )
    plan = write_plan(tmp_path / "plan.csv", "t,x,v_x,F", foreign_plan(1, 0.4))
    wired, found, expected = (
        wire_fmu(tmp_path / "cart.fmu", plan, map_path=tmp_path / "map.toml"),
        [],
        [],
    )
    causes = perturbations(wired.foreign.model, wired.plan, ["body.mass", "gain", "delay"])
    with FmuArena.of(wired, {"replay_terminal_position_error": 1.0}) as arena:
        for sizes in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.3), (-1.0, 1.0, 0.7), (0.5, -2.0, 0.0)):
            world = moved(arena.nominal, causes, np.array(sizes))
            mass, force = float(world.parameters[0]), FORCE * float(world.gain[0])
            meets_with = math.sqrt(4.0 + 2.0 * force / mass * (STOP - 0.3))
            expected.append(
                (
                    force / STIFFNESS
                    + math.hypot(force / STIFFNESS, meets_with * math.sqrt(mass / STIFFNESS))
                )
                / limit
            )
            for trial in (arena.trial(world), arena.checked(world)):
                found.append(trial.shares["max_penetration"])
    assert found == pytest.approx(np.repeat(expected, 2).tolist(), abs=1e-4)
    assert min(expected) < 1.0 < max(expected)


def test_who_takes_no_uneven_steps_gets_a_delay_as_the_mean_of_a_step(
    free: Callable[..., WiredFmu],
):
    wired = free(kinds='<CoSimulation modelIdentifier="cart"/>')
    with FmuArena.of(wired, asked_limits(wired.judge().score)) as arena:
        assert arena.nominal.whole
        late = arena.trial(
            moved(
                arena.nominal,
                perturbations(wired.foreign.model, wired.plan, ["delay"]),
                np.array([0.5]),
            )
        )
    assert late.ratio < 1.0  # the command is the same all the way


@pytest.mark.slow
def test_by_its_own_step_it_is_tried_so_and_checked_with_a_fifth(free: Callable[..., WiredFmu]):
    wired = free(own_step=True)
    with FmuArena.of(wired, asked_limits(wired.judge().score)) as arena:
        assert (arena.fineness, arena.by, arena.feedback) == (
            50,
            "with a fifth of the step",
            None,
        )


@pytest.mark.parametrize(
    ("more", "asked", "parts"),
    [
        ("", ["wind"], ["'wind'", "cannot be perturbed", "parameters, start", "body.mass"]),
        ("", ["body.mas"], ["'body.mas'", "did you mean body.mass?"]),
        (
            "[uncertainty]\n'body.mass' = 0\n",
            ["body.mass"],
            ["'body.mass'", "certain", "[uncertainty]"],
        ),
        (
            "[uncertainty]\n'body.mass' = 0\n",
            ["parameters"],
            ["nothing of it can be perturbed by parameters"],
        ),
        (
            "[uncertainty]\n'body.mass' = 2.5\n",
            ["parameters"],
            ["uncertainty.body.mass", "-0.5", "at least 0"],
        ),
        (
            "[uncertainty]\n'body.mess' = 0.1\n",
            ["parameters"],
            ["uncertainty.body.mess", "no variable", "body.mass"],
        ),
        (
            "[uncertainty]\n'drive.force' = 0.1\n",
            ["parameters"],
            ["uncertainty.drive.force", "no parameter", "input"],
        ),
        ("[uncertainty]\n'body.mass' = -0.1\n", ["parameters"], ["uncertainty.body.mass"]),
    ],
)
def test_what_cannot_be_perturbed_is_refused_in_a_sentence(
    free: Callable[..., WiredFmu], more: str, asked: list[str], parts: list[str]
):
    with pytest.raises(TouchstoneError) as told:
        robustness(free(more=more), samples=10, kinds=asked)
    assert not unsaid(told.value, *parts)


def test_a_plan_without_goal_and_positions_has_nothing_to_arrive_at(
    free: Callable[..., WiredFmu], tmp_path: Path
):
    free()
    plan = write_plan(tmp_path / "short.csv", "t,F", foreign_plan()[: STEPS + 1])
    wired = wire_fmu(tmp_path / "cart.fmu", plan, map_path=tmp_path / "map.toml")
    with pytest.raises(TouchstoneError) as told:
        robustness(wired, samples=10, anyway=True)
    assert not unsaid(told.value, "nothing to arrive at", "[goal]", "replay_error")


@pytest.mark.slow
def test_the_command_takes_an_fmu(
    free: Callable[..., WiredFmu],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
):
    free()
    monkeypatch.chdir(tmp_path)
    given = [
        "robust",
        "plan.csv",
        "--fmu",
        "cart.fmu",
        "--map",
        "map.toml",
        "--samples",
        "10",
        "--perturb",
        "body.mass",
    ]
    assert run([*given, "--json", "--html", "page.html", "--csv", "worlds.csv"]) == 0
    record = from_json(RobustnessRecord, capfd.readouterr().out)
    assert (record.scene, record.verdict, [item.name for item in record.causes]) == (
        "cart",
        "consistent",
        ["body.mass"],
    )
    assert not unsaid(
        (tmp_path / "page.html").read_text(), "How much plan.csv can take on cart", "body.mass"
    )
    assert (tmp_path / "worlds.csv").read_text().splitlines()[
        0
    ] == 'world,body.mass,"share of limit, inputs alone"'
    assert run([*given[:-1], "body.mas"]) == 2
    assert not unsaid(capfd.readouterr().err, "did you mean body.mass?")
    rows = (tmp_path / "plan.csv").read_text(encoding="utf-8").splitlines()
    time, position, *others = rows[-2].split(",")
    rows[-2] = ",".join([time, str(float(position) + 1.0), *others])
    (tmp_path / "plan.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    assert run(given) == 2
    assert not unsaid(capfd.readouterr().err, "does not hold to begin with", "--anyway")
    for wrong, parts in (
        (["--scene", "three_cart"], ["--scene or --fmu"]),
        (["--map", "map.toml"], ["--map", "--fmu"]),
        (["--own-step"], ["--own-step", "--fmu"]),
    ):
        base = (
            given[:6] if wrong[0] == "--scene" else ["robust", "plan.csv", "--scene", "three_cart"]
        )
        assert run([*base, *wrong]) == 2
        assert not unsaid(capfd.readouterr().err, *parts)


def test_a_cart_that_is_heavier_is_heavier(free: Callable[..., WiredFmu]):
    """The map's own parameters stay where a world does not move them."""
    wired = free(more="[parameters]\n'body.mass' = 1.0\n")
    (mass,) = perturbations(wired.foreign.model, wired.plan, ["body.mass"])
    assert (mass.nominal, mass.size) == (1.0, 0.05)
    with FmuArena.of(wired, {"replay_error": NEAR}) as arena:
        ends = [
            arena.trial(moved(arena.nominal, [mass], np.array([size]))).states[-1, 0]
            for size in (0.0, 1.0)
        ]
    assert ends == pytest.approx(
        [0.3 + 2.0 * TIME + FORCE / m * TIME**2 / 2.0 for m in (1.0, 1.05)], abs=1e-8
    )
    assert math.isfinite(ends[0])
