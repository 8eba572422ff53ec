"""Records as they are written and read: columns of numbers, names of files, order, defaults.

A folder of them with what is broken in it; runs in parts told as one.
"""

import base64
import json
import math
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from pydantic import ValidationError
from wording import unsaid

import models.results.check
import models.results.run
import reports.load
from models.results.check import CheckRecord, FmuCheckRow, FmuRecord, Status, divided
from models.results.run import (
    LONGEST,
    SCHEMA_VERSION,
    EquationRecord,
    LegRecord,
    RunRecord,
    SceneRecord,
    StageRecord,
    stage_files,
    thin,
)
from models.results.stored import from_data, from_json, record_of, to_data, to_json
from models.results.verdict import Metric, Question
from reports.load import LARGEST_BYTES, ReportError, Stored, load, other_version, record_files
from tests.reports import record_factory as factory


def stage(**changes) -> StageRecord:
    said = {
        "index": 0,
        "method": "m",
        "method_title": "",
        "kind": "direct",
        "eps": None,
        "outcome": "solved",
        "advice": "",
    }
    return StageRecord(**(said | changes))


def check(name: str = "h01", kind: str = "stress", **changes) -> CheckRecord:
    said = {
        "key": f"{kind}-{name}", "kind": kind, "name": name, "expected": "", "outcome": "answered",
        "passed": True, "wall_seconds": 1.0,
        "cpu_seconds": 1.0, "provenance": factory.provenance(),
    }  # fmt: skip
    return CheckRecord(**(said | changes))


@pytest.mark.parametrize(
    ("points", "longest", "found"),
    [
        (0, 5, []), (1, 5, [0]), (2, 5, [0, 1]), (5, 5, [0, 1, 2, 3, 4]), (6, 5, [0, 1, 2, 4, 5]),
        (9, 5, [0, 2, 4, 6, 8]), (9, 2, [0, 8]),
    ],
)  # fmt: skip
def test_points_are_thinned_evenly_with_both_ends(points: int, longest: int, found: list[int]):
    assert thin(points, longest).tolist() == found


def test_nothing_is_thinned_up_to_what_a_plot_can_show():
    assert LONGEST == 1500
    assert len(thin(1500)) == len(thin(1501)) == len(thin(40_000)) == 1500
    assert thin(40_000)[[0, -1]].tolist() == [0, 39_999]


def test_columns_are_the_base64_of_their_bytes():
    values = (1.0, -2.5, 1e-300)
    found = stage(history={"loss": values})
    text = json.loads(to_json(found))["history"]["loss"]
    assert base64.b64decode(text) == struct.pack("<3d", *values)
    assert from_json(StageRecord, to_json(found)) == found
    listed = from_data(StageRecord, to_data(found) | {"history": {"loss": [1.0, 2.0]}})
    assert listed.history["loss"] == (1.0, 2.0)


def test_files_of_the_last_stage_have_no_number():
    assert (
        stage_files(0, 1)
        == stage_files(2, 3)
        == {"trajectory": "trajectory.nc", "replay": "replay.nc", "tracked": "tracked.nc"}
    )
    assert stage_files(1, 3) == {
        "trajectory": "trajectory_2.nc",
        "replay": "replay_2.nc",
        "tracked": "tracked_2.nc",
    }


def test_a_metric_is_found_by_its_name():
    first, second = (Metric(name=name, value=1.0, unit="", meaning="") for name in ("a", "b"))
    found = stage(metrics=(first, second))
    assert (found.metric("b"), found.metric("c")) == (second, None)


@pytest.mark.parametrize(("error", "known"), [(0.0, True), (1e-9, True), (math.inf, False)])
def test_metric_error_unknown_stays_infinite_in_json(error: float, known: bool):
    metric = Metric(name="a", value=1.0, unit="", meaning="", error=error, question=Question.MOTION)
    text = to_json(metric)
    assert (json.loads(text)["error"] is not None) is known is metric.has_known_error
    assert from_json(Metric, text) == metric


@pytest.mark.parametrize("value", [None, math.inf, -math.inf, math.nan])
def test_metric_value_not_finite_read_as_none(value: float | None):
    metric = Metric(name="a", value=value, unit="", meaning="", limit=value, error=math.nan)
    found = from_json(Metric, to_json(metric))
    assert (found.value, found.limit, found.error) == (None, None, math.inf)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999", '"soon"'])
def test_metric_number_not_finite_in_json_refused(text: str):
    damaged = to_json(Metric(name="a", value=2.5, unit="", meaning="")).replace("2.5", text)
    with pytest.raises(ValidationError):
        from_json(Metric, damaged)


@pytest.mark.parametrize("places", [(), (1,), (0, 2), (1, 0), (0, 0)])
def test_a_leg_has_its_stages_in_order(places: tuple[int, ...]):
    LegRecord(key="", pipeline="", stages=(stage(), stage(index=1)), files={})
    with pytest.raises(ValueError, match="stages"):
        LegRecord(
            key="", pipeline="", stages=tuple(stage(index=place) for place in places), files={}
        )


def test_what_a_run_and_a_check_are_called():
    run = factory.runs()[0]
    assert (run.title, check().title) == ("three_cart x strict", "stress: h01")


def test_a_record_says_itself_what_it_is():
    run = factory.runs()[0]
    for record in (run, check()):
        assert record_of(to_json(record).encode()) == record
    assert divided([check("b"), run, check("a")]) == ((run,), (check("b"), check("a")))
    with pytest.raises(ValidationError) as caught:
        record_of(b"{}")
    assert ("check", "kind") in {error["loc"] for error in caught.value.errors()}


def test_checks_of_an_fmu_are_counted_by_how_they_ended():
    ends = ("failed", "passed", "not offered", "failed", "passed", "passed")
    rows = tuple(
        FmuCheckRow(
            name=f"{n}", type="ME", claim="", status=Status(status), sentence="", seconds=0.0
        )
        for n, status in enumerate(ends)
    )
    fmu = FmuRecord(
        version="2.0",
        types=("ME",),
        bytes=1,
        sha256="",
        export_seconds=0.0,
        check_seconds=0.0,
        rows=rows,
    )
    assert [fmu.count(status) for status in ("passed", "failed", "not offered")] == [3, 2, 1]
    assert [row.name for row in fmu.failed] == ["0", "3"]


def test_records_lie_in_folders_that_are_finished(tmp_path: Path):
    assert record_files(tmp_path) == []
    for name in ("b", "a", ".partial", "c.tmp"):
        (tmp_path / "runs" / name).mkdir(parents=True)
    (tmp_path / "runs" / "file").write_text("x")
    assert record_files(tmp_path) == [
        tmp_path / "runs" / name / "record.json" for name in ("a", "b")
    ]


def test_without_its_campaign_a_folder_is_told_by_name(tmp_path: Path):
    """Runs by scene, pipeline and key; checks by kind and name; all that is there."""
    base = factory.runs()[0]

    def run(scene: str, pipeline: str, key: str):
        return replace(base, scene=replace(base.scene, name=scene), pipeline=pipeline, key=key)

    runs = [run("a", "z", "5"), run("a", "y", "4"), run("a", "y", "3"), run("b", "x", "1")]
    checks = [check("b", "fmu"), check("a", "stress"), check("a", "fmu")]
    folder = factory.store(tmp_path / "all", [*reversed(runs), *checks])  # type: ignore[list-item]
    (folder / "campaign.json").unlink()
    stored = load(folder)
    assert [item.key for item in stored.runs] == ["3", "4", "5", "1"]
    assert [item.key for item in stored.checks] == ["fmu-a", "fmu-b", "stress-a"]
    assert (stored.campaign, stored.missing, stored.foreign) == (None, (), 0)
    (item,) = stored.unreadable
    assert (item.path, "not there" in item.sentence) == ("campaign.json", True)


def test_with_its_campaign_a_folder_is_told_in_its_order(tmp_path: Path):
    runs = factory.runs()[:4]
    keys = ("stress-h01", runs[2].key, "lost", runs[0].key, runs[1].key, runs[0].key)
    folder = factory.store(
        tmp_path / "all", [*runs, check(), check("h02")], factory.campaign(runs, keys=keys)
    )
    (folder / "runs" / runs[1].key / "record.json").write_text("{")
    stored = load(folder)
    assert [item.key for item in stored.runs] == [runs[2].key, runs[0].key]
    assert [item.key for item in stored.checks] == ["stress-h01"]
    assert stored.missing == ("lost",), "what is broken is not missing"
    assert stored.foreign == 2
    assert stored.campaign == factory.campaign(runs, keys=keys)
    assert [item.path for item in stored.unreadable] == [f"runs/{runs[1].key}/record.json"]


def sentence_of(tmp_path: Path, text: str | None) -> str:
    """What is said of a run's record that holds this, or is not there."""
    run = factory.runs()[0]
    folder = factory.store(tmp_path / "all", [run])
    path = folder / "runs" / run.key / "record.json"
    if text is None:
        path.unlink()
    else:
        path.write_text(text)
    (item,) = load(folder).unreadable
    return item.sentence


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (None, ["not there", "run the campaign again"]),
        ("{", ["not complete JSON", "run it again"]),
        ("{}", [f"record schema {SCHEMA_VERSION}", "at check.key: Field required", "and 8 more"]),
        ("1", [f"record schema {SCHEMA_VERSION}", "Input should be"]),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_record_is_said(tmp_path: Path, text: str | None, parts: list[str]):
    said = sentence_of(tmp_path, text)
    assert not unsaid(said, *parts)


def test_one_field_that_does_not_fit_is_named_alone(tmp_path: Path):
    data = json.loads(to_json(factory.runs()[0]))
    said = sentence_of(tmp_path, json.dumps(data | {"wall_seconds": "soon"}))
    assert "at run.wall_seconds: " in said
    assert "more" not in said
    said = sentence_of(tmp_path, json.dumps(data | {"profile": {"p" * 200: "soon"}}))
    assert f"at run.profile.{'p' * (120 - len('run.profile.'))}: " in said
    key = "k" * 39 + "xyz"
    said = sentence_of(tmp_path, json.dumps(data | {"key": key}))
    assert repr(key[:40]) in said


def test_what_is_larger_than_any_record_is_not_read(tmp_path: Path):
    run = factory.runs()[0]
    folder = factory.store(tmp_path / "all", [run])
    path = folder / "runs" / run.key / "record.json"
    for size, said in (
        (LARGEST_BYTES + 1, "larger than 64 MB"),
        (LARGEST_BYTES, "not complete JSON"),
    ):
        os.truncate(path, size)
        (item,) = load(folder).unreadable
        assert said in item.sentence
    assert LARGEST_BYTES == 64 * 2**20


def test_a_file_that_refuses_is_told_by_the_systems_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    found: list = []
    (tmp_path / "file").write_text("{}")
    for error, words in (
        (PermissionError(13, "Permission denied"), "Permission denied"),
        (TimeoutError(), "TimeoutError"),
    ):
        monkeypatch.setattr(Path, "read_bytes", Mock(side_effect=error))
        assert reports.load.read_record(tmp_path / "file", tmp_path, record_of, found) is None
        assert (found[-1].path, words in found[-1].sentence) == ("file", True)


def test_what_is_no_record_at_all_has_no_place_in_it(tmp_path: Path):
    folder = factory.store(tmp_path / "all", factory.runs()[:1])
    (folder / "campaign.json").write_text("1")
    (item,) = load(folder).unreadable
    assert f"record schema {SCHEMA_VERSION} (Input should be" in item.sentence


_BROKEN = {
    "cut short": lambda text: text[: len(text) // 2], "empty": lambda _: "",
    "not JSON": lambda _: "\x00\x01<html>", "a number": lambda _: "1",
    "another schema": lambda text: json.dumps(json.loads(text) | {"surprise": 1}),
    "a string for a number": lambda text: json.dumps(json.loads(text) | {"wall_seconds": "soon"}),
    "NaN": lambda text: json.dumps(json.loads(text) | {"wall_seconds": float("nan")}),
    "infinity": lambda text: json.dumps(json.loads(text) | {"cpu_seconds": float("inf")}),
    "deep": lambda _: "[" * 100_000,
    "another key": lambda text: json.dumps(json.loads(text) | {"key": "../../etc"}),
}  # fmt: skip


@pytest.mark.parametrize("name", _BROKEN)
def test_a_broken_record_is_named_and_the_rest_is_read(factory, tmp_path, name):
    good, bad = factory.runs()[:2]
    folder = factory.store(tmp_path / "all", [good, bad])
    path = folder / "runs" / bad.key / "record.json"
    path.write_text(_BROKEN[name](path.read_text()))
    stored = load(folder)
    assert [run.key for run in stored.runs] == [good.key]
    assert [item.path for item in stored.unreadable] == [f"runs/{bad.key}/record.json"]
    assert stored.unreadable[0].sentence.endswith(".")
    assert stored.missing == ()


def test_no_folder_is_one_sentence(tmp_path):
    with pytest.raises(ReportError, match="there is no such folder"):
        load(tmp_path / "nowhere")


def test_load_store_of_another_version_refused(factory, tmp_path):
    folder = factory.store(tmp_path / "all", factory.runs()[:2])
    path = folder / "campaign.json"
    written = json.loads(path.read_text())
    path.write_text(json.dumps(written | {"schema_version": SCHEMA_VERSION - 1}))
    with pytest.raises(ReportError) as caught:
        load(folder)
    assert str(caught.value) == (
        f"{folder}: this store was written by another version of touchstone; "
        "use another --out folder or delete it."
    )


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        (json.dumps({"schema_version": SCHEMA_VERSION - 1}), True),
        (json.dumps({"schema_version": SCHEMA_VERSION + 1}), True),
        (json.dumps({"schema_version": "9" * 50}), True),
        (json.dumps({"schema_version": SCHEMA_VERSION}), False),
        (json.dumps({}), False),
        ("[", False),
        ("[" * 100_000, False),
        (None, False),
    ],
)
def test_other_version_of_any_campaign_file(text: str | None, refused: bool, tmp_path: Path):
    if text is not None:
        (tmp_path / "campaign.json").write_text(text, encoding="utf-8")
    assert bool(other_version(tmp_path)) is refused


# Not empty: what is meant where nothing is said.
MEANT = {
    "RunRecord.schema_version": 10, "CampaignRecord.schema_version": 10,
    "CheckRecord.schema_version": 10,
    "ReplayRecord.judged": "open",
    "RunRecord.verdict": "no plan", "StageRecord.verdict": "no plan",
    "ContactRecord.bodies": ("", ""), "ShapeRecord.place": (None, None, None), "SeriesRecord.line": True,
}  # fmt: skip


def defaults() -> Iterator[tuple[str, object]]:
    for module in (models.results.run, models.results.check):
        for model in vars(module).values():
            if is_dataclass(model) and model.__module__ == module.__name__:
                for field in fields(model):
                    default = field.default
                    if field.default_factory is not MISSING:
                        default = field.default_factory()
                    if default is not MISSING:
                        yield f"{model.__name__}.{field.name}", default


ALL = dict(defaults())


@pytest.mark.parametrize("name", ALL)
def test_what_is_not_said_is_nothing(name: str):
    default = ALL[name]
    if name in MEANT:
        assert default == MEANT[name]
    elif is_dataclass(default):
        assert not any(vars(default).values())
    else:
        assert not default, "an empty text, list, None, no or nought"


def test_all_that_is_meant_exists():
    assert len(ALL) > 100
    assert set(MEANT) <= set(ALL)


def test_cheapest_other_scene_and_verdict_left_out():
    def run(scene: str, price: float, pipeline: str = "mpcc", verdict: str = "holds") -> RunRecord:
        template = factory.runs()[0]
        last = replace(template.stages[-1], cost=price, verdict=verdict)
        named = {"pipeline": pipeline, "scene": factory.scene(scene), "stages": (last,)}
        return replace(template, **{**named, "verdict": verdict})

    runs = (
        run("one", 3.0),
        run("one", 1.0, "soft", "violates"),
        run("one", 2.0, "tracked", "holds with feedback"),
        run("two", 0.5),
    )
    assert [(item.pipeline, price) for item, price in Stored(None, runs).cheapest("one")] == [
        ("tracked", 2.0),
        ("mpcc", 3.0),
    ]


def test_equations_are_packed_in_json_and_read_back():
    equation = EquationRecord(caption="dynamics <of> ü", mathml="<math>" + "<mi>x</mi>" * 500)
    scene = replace(factory.scene(), equations=(equation, equation))
    text = to_json(scene)
    assert len(text) < 5000
    assert from_json(type(scene), text) == scene


@pytest.mark.parametrize("text", ["###", "MTIz", base64.b64encode(zlib.compress(b"[1]")).decode()])
def test_damaged_equations_are_refused(text: str):
    record = json.loads(to_json(factory.scene())) | {"equations": text}
    with pytest.raises(ValidationError, match="equations"):
        from_data(SceneRecord, record)
