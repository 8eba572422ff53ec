"""Shares and first failures: by hand, on known functions, and on three carts as a whole."""

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from wording import unsaid

import touchstone as ts
from models.catalog import load_scene
from models.errors import TouchstoneError
from models.results.robustness import FirstFailure, RobustnessRecord, Way
from models.results.stored import from_json, to_json
from models.trajectory import write_csv
from tests.validate.judge.robustness.test_worlds import resting
from validate.cli.robust import command
from validate.judge.judgement import Judgement
from validate.judge.robustness import Robustness, robustness
from validate.judge.robustness.robustness import Share, first_failure
from validate.judge.robustness.trials import SceneArena, asked_limits
from validate.judge.robustness.worlds import moved, perturbations

SCENE = load_scene("three_cart")
RESTING = {"t": 0.01 * np.arange(501), "u1": np.zeros(500), "u3": np.zeros(500)}


@pytest.mark.parametrize(
    ("arrived", "samples", "low", "high"),
    [
        (45, 50, 0.78640, 0.95652),
        (5, 50, 0.04348, 0.21360),
        (50, 50, 0.92865, 1.0),
        (0, 50, 0.0, 0.07135),
        (0, 0, 0.0, 1.0),
    ],
)
def test_the_interval_is_wilsons(arrived: int, samples: int, low: float, high: float):
    share = Share.of([0.5] * arrived + [2.0] * (samples - arrived))
    assert (share.arrived, share.samples) == (arrived, samples)
    assert share.interval == pytest.approx((low, high), abs=1e-5)
    assert share.share == (arrived / samples if samples else 0.0)


@pytest.mark.parametrize(
    ("at", "largest"),
    [(0.001, 64.0), (0.03, 64.0), (0.7, 64.0), (3.0, 64.0), (63.9, 64.0), (0.5, 0.6)],
)
def test_the_first_failure_is_found_to_a_hundredth(at: float, largest: float):
    assert first_failure(lambda size: size / at, largest) == pytest.approx(at, rel=0.01)


def test_what_never_fails_and_what_fails_before_are_told():
    asked: list[float] = []
    assert first_failure(lambda size: asked.append(size) or 1.0, 5.0) is None
    assert max(asked) == 5.0
    assert first_failure(lambda size: 1.1, 5.0) == 0.0
    assert first_failure(
        lambda size: 0.9 if size < 1.0 or size > 2.0 else 1.1, 64.0
    ) == pytest.approx(1.0, rel=0.01), "the first, not the last"


@pytest.fixture(scope="module")
def found(judged: Judgement) -> Robustness:
    return robustness(SCENE, judged.plan, samples=32)


@pytest.mark.slow
def test_what_is_measured_is_the_same_again_and_another_for_another_seed(judged: Judgement):
    first, again, other = (
        robustness(SCENE, judged.plan, samples=10, seed=seed, kinds=["gain", "noise"])
        for seed in (0, 0, 1)
    )
    records = [
        json.loads(to_json(replace(item, seconds=0.0), kind=RobustnessRecord))
        for item in (first, again, other)
    ]
    assert records[0] == records[1]
    assert first.alone.tried == again.alone.tried
    assert (np.array(first.alone.tried) != np.array(other.alone.tried)).all()
    assert records[0]["failures"] == records[2]["failures"], (
        "one perturbation by itself is no matter of luck"
    )


@pytest.mark.slow
def test_three_carts_take_least_of_damping(judged: Judgement, found: Robustness):
    assert found.complete
    assert (found.alone.share.samples, found.feedback.share.samples) == (32, 10)
    assert (
        found.alone.share.arrived
        == int((np.array(found.alone.tried) <= 1.0).sum())
        == 32 - sum(found.alone.fails_by.values())
    )
    assert found.feedback.share.share > found.alone.share.share
    for way in found.ways:
        assert (way.checked.count, way.checked.differ) == (10, ())
        assert way.checked.largest_difference < 1e-3
    weakest = found.weakest
    assert (weakest.cause.name, weakest.direction, weakest.by) == (
        "c",
        -1,
        "replay_terminal_position_error",
    )
    with SceneArena.of(SCENE, judged.plan, asked_limits(judged.score)) as arena:
        for item in found.failures:
            if item.sizes is not None:
                for share, arrives in ((0.98, True), (1.02, False)):
                    trial = arena.checked(
                        moved(
                            arena.nominal,
                            [item.cause],
                            np.array([item.direction * share * item.sizes]),
                        )
                    )
                    assert trial.arrives is arrives, (item.cause.name, item.direction)
    ways = {(item.cause.name, item.direction) for item in found.failures}
    assert len(ways) == 2 * 12 + 1, "noise has no direction, a delay has one"


@pytest.mark.slow
def test_what_was_tried_before_ctrl_c_is_kept(judged: Judgement):
    said: list[str] = []

    def tell(text: str) -> None:
        said.append(text)
        if text.startswith("c by itself"):
            raise KeyboardInterrupt

    found = robustness(SCENE, judged.plan, samples=10, tell=tell)
    assert not found.complete
    assert found.alone.share.samples == 10
    assert [(item.cause.name, item.direction) for item in found.failures] == [("m", -1), ("m", 1)]
    assert "interrupted" in found.summary

    def at_once(text: str) -> None:
        raise KeyboardInterrupt

    nothing = robustness(SCENE, judged.plan, samples=10, tell=at_once)
    assert "no world was tried" in nothing.summary


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"samples": 0}, ["samples", "0", "10 to 1000000"]),
        ({"samples": 10**9}, ["samples", "1000000000"]),
        ({"samples": 100.5}, ["samples", "100.5", "whole number"]),
        ({"seed": -1}, ["seed", "-1", "at least 0"]),
        ({"kinds": ["wind"]}, ["three_cart", "wind", "parameters, start, gain, noise, delay"]),
        ({}, ["does not hold to begin with", "violates", "--anyway"]),
        ({"scene": "three_crat"}, ["three_cart"]),
    ],
)
def test_what_cannot_be_measured_is_refused_in_a_sentence(changes: dict, parts: list[str]):
    with pytest.raises(TouchstoneError) as told:
        robustness(**{"scene": SCENE, "plan": RESTING} | changes)
    assert not unsaid(told.value, *parts)


def test_a_plan_that_does_not_hold_is_measured_anyway():
    found = robustness(SCENE, RESTING, samples=10, anyway=True, kinds=["gain"])
    assert (found.alone.share.arrived, found.feedback) == (0, None)
    assert [item.sizes for item in found.failures] == [0.0] * 4


def test_a_first_failure_is_told_in_its_unit_and_in_sizes():
    cause = perturbations(SCENE, resting())[1]
    said = FirstFailure(cause=cause, direction=-1, sizes=2.0, amount=-0.2, tried=64.0, by="")  # type: ignore[arg-type]
    assert said.words == "c by -0.2 N s/m (2.00 of its size)"


@pytest.mark.slow
def test_the_command_tells_it_in_text_json_csv_and_a_page(judged: Judgement, tmp_path: Path):
    write_csv(tmp_path / "plan.csv", judged.plan, SCENE)
    given = [
        str(tmp_path / "plan.csv"),
        "--scene",
        "three_cart",
        "--samples",
        "12",
        "--perturb",
        "parameters",
    ]
    page, rows = tmp_path / "out" / "page.html", tmp_path / "worlds.csv"
    told = CliRunner().invoke(
        command, [*given, "--json", "--html", str(page), "--csv", str(rows)], standalone_mode=False
    )
    assert told.return_value == 0, told.output
    record = from_json(RobustnessRecord, told.stdout)
    assert [item.name for item in record.causes] == ["m", "c", "k", "d"]
    assert json.loads(told.stdout)["ways"][0]["share"]["samples"] == 12
    table = list(csv.DictReader(io.StringIO(rows.read_text())))
    assert len(table) == 12
    assert (
        sum(float(row["share of limit, inputs alone"]) <= 1.0 for row in table)
        == record.ways[0].share.arrived
    )
    text = page.read_text()
    assert not unsaid(
        text,
        "How much plan.csv can take on three_cart",
        record.ways[0].share.words,
    )
    plain = CliRunner().invoke(command, given, standalone_mode=False)
    assert plain.stdout.startswith(f"{record.verdict}: ")
    assert not unsaid(
        plain.stdout,
        record.ways[0].share.words,
        "It takes least of: c",
        "10 worlds tried by the reference",
    )


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [(["plan.csv"], ["--scene"]), (["nothing x mpcc", "--in", "nowhere"], ["nowhere"]),
     (["no.csv", "--scene", "three_cart"], ["no.csv"])]
)  # fmt: skip
def test_a_plan_that_is_not_there_is_named(arguments: list[str], parts: list[str]):
    told = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert not unsaid(told.exception, *parts)


def test_what_fails_is_named_the_most_frequent_first():
    way = Way(name="", fails_by={"time_limit": 2, "replay_terminal_position_error": 1234})
    assert way.fails == "replay terminal position error in 1,234; time limit in 2"


@pytest.mark.parametrize(
    ("call", "parts"),
    [
        (lambda: ts.robustness([], {}), ("list is no scene",)),
        (
            lambda: ts.robustness("three_cart", plan_at_rest(), hold="q", anyway=True),
            ("hold 'q'", "zero or linear"),
        ),
        (
            lambda: ts.robustness("three_cart", plan_at_rest(1e-9)),
            ("plan", "5e+09 s", "three_cart lasts 5 s", "Give t in seconds"),
        ),
        (lambda: ts.robustness("three_cart", "plan.csv", map="map.toml"), ("map", "FMU")),
    ],
    ids=lambda value: "",
)
def test_robustness_wrong_arguments_one_sentence(
    call: Callable[[], object], parts: tuple[str, ...]
):
    with pytest.raises(TouchstoneError) as caught:
        call()
    assert not unsaid(str(caught.value), *parts)


def plan_at_rest(unit: float = 1.0) -> dict[str, np.ndarray]:
    """Columns of a plan of three_cart at rest, its times in this unit [s]."""
    start, t = ts.scene("three_cart").task.start, np.linspace(0.0, 5.0 / unit, 501)
    still = dict(zip(("q1", "q2", "q3", "v1", "v2", "v3"), np.tile(start, (501, 1)).T, strict=True))
    return {"t": t, **still, "u1": np.zeros(501), "u3": np.zeros(501)}
