"""Pages of one table or sentence: FMUs, provenance, sizes, seconds, index, a scene's step."""

import math
import re
from dataclasses import replace

import pytest
from wording import unsaid

from models.results.check import CheckRecord
from models.results.run import EquationRecord, ModelSize, RunRecord, TimeStepRecord
from models.results.stored import from_data
from reports.load import Stored, Unreadable
from reports.pages import campaign, checks, overview, scene, section
from reports.pages.section import Report
from reports.render import Templates
from tests.reports import record_factory as factory
from tests.reports.record_factory import ran


def report(
    *records: RunRecord,
    checks: tuple[CheckRecord, ...] = (),
    single: bool = False,
    at: str = "pages/",
    **campaign: object,
) -> Report:
    told = factory.campaign(list(records), **campaign) if campaign else None
    return Report(Stored(told, records, (), (), 0, checks), at=at, single=single)


def profiled(name: str, wall: float, **phases: float) -> RunRecord:
    return replace(ran(name), wall_seconds=wall, profile=phases)


def test_seconds_are_told_by_group_and_the_slowest_first():
    found = campaign.time_spent(
        report(
            profiled("quick", 2.0, replay=1.5, odd_phase=0.5),
            profiled("slow", 10.0, imports=2.0, scene=1.0, solve_rest=4.0, replay=3.0),
            ran("none"),
        )
    )
    slow, quick = found.values["slowest"]
    assert (slow.run.pipeline, slow.link) == ("slow", "pages/three_cart--slow.html")
    assert dict(zip(found.values["groups"], slow.groups, strict=True)) == {
        "starting": 3.0, "compiling": 0.0, "modelling": 0.0, "evaluating": 0.0,
        "linear algebra": 0.0, "judging": 3.0, "other": 4.0,
    }  # fmt: skip
    assert slow.phases == (
        ("solving otherwise", 4.0),
        ("replaying", 3.0),
        ("imports", 2.0),
        ("reading the scene", 1.0),
    )
    assert [part for part in slow.bar if part[1]] == [
        (0.0, 60.0, "c0", "starting: 3.00 s"), (60.0, 60.0, "c5", "judging: 3.00 s"),
        (120.0, 80.0, "rest", "other: 4.00 s"),
    ]  # fmt: skip
    assert [part[:3] for part in quick.bar if part[1]] == [
        (0.0, 30.0, "c5"),
        (30.0, 10.0, "rest"),
    ], "of the slowest run"
    assert quick.phases == (("replaying", 1.5), ("odd phase", 0.5))
    assert not unsaid(
        found.values["sentence"],
        "12.00 s of 2 runs … replaying (38 %), solving otherwise (33 %) and imports (17 %).",
    )
    assert (found.values["without"], found.values["width"], found.said) == (
        1,
        200.0,
        found.values["sentence"],
    )
    assert found.values["styles"] == {
        "starting": "c0", "compiling": "c1", "modelling": "c2", "evaluating": "c3",
        "linear algebra": "c4", "judging": "c5", "other": "rest",
    }  # fmt: skip
    nothing = campaign.time_spent(report(profiled("zero", 0.0, replay=0.0)))
    assert (nothing.values["sentence"], nothing.said) == (
        "",
        "The slowest runs, each by what its seconds were spent on.",
    )
    assert campaign.time_spent(report(ran("none"))) is None
    many = campaign.time_spent(
        report(*(profiled(f"run {place}", float(place % 7), replay=1.0) for place in range(12)))
    )
    assert many is not None
    assert [item.run.pipeline for item in many.values["slowest"]] == [
        f"run {place}" for place in (6, 5, 11, 4, 10, 3, 2, 9, 1, 8)
    ]


@pytest.mark.parametrize("share", [0.0999, 0.1001])
def test_a_tenth_of_the_seconds_is_told(share: float):
    found = campaign.time_spent(report(profiled("one", 1.0, replay=1.0 - share, imports=share)))
    assert ("imports" in found.values["sentence"]) == (share > 0.1)


def examined(
    name: str, passed: bool = True, outcome: str = "answered", **changes: object
) -> CheckRecord:
    said = {
        "key": name, "kind": "FMU", "name": name, "expected": "", "outcome": outcome,
        "passed": passed, "found": "", "wall_seconds": 2.0,
        "cpu_seconds": 1.5,
    }  # fmt: skip
    return from_data(CheckRecord, {**said, "provenance": factory.provenance(), **changes})


def test_fmus_by_scene_and_version():
    found = checks.fmus(report(checks=(
        examined("bank, FMI 2.0", scene="bank"), examined("hill, FMI 3.0", False, scene="hill"),
        examined("bank, FMI 3.0", False, "time_limit", scene="bank"),
        examined("other", kind="stress case"),
    )))  # fmt: skip
    assert found is not None
    assert [(view.name, view.version, view.anchor,
             view.ended) for view in found.values["views"]] == [
        ("bank", "2.0", "fmu-1", ""), ("hill", "3.0", "fmu-2", "failed"),
        ("bank", "3.0", "fmu-3", "time limit"),
    ]  # fmt: skip
    assert not unsaid(
        found.said,
        "3 FMUs of 2 scenes … 2.0 and 3.0: 2 of them do not pass … 0 passed, 0 failed, 0 not offered; 4 CPU",
    )
    assert found.values["ours"] is True
    one = checks.fmus(report(checks=(examined("bank, FMI 2.0", False, scene="bank"),)))
    assert not unsaid(one.said, "1 FMU of 1 scene in FMI 2.0: 1 … does not pass.")
    good = checks.fmus(report(checks=(examined("bank, FMI 2.0"),)))
    assert good.said.startswith("1 FMU in FMI 2.0: every one passes."), "somebody's, of no scene"
    assert good.values["ours"] is False
    assert checks.fmus(report(checks=(examined("other", kind="stress case"),))) is None


def test_what_a_runs_origin_has_other_than_the_campaigns():
    first = factory.provenance()
    assert campaign.differences(first, first) == []
    other = factory.provenance(
        touchstone="9",
        commit="b",
        python="4",
        platform="P",
        cpu="C",
        compiler="cc",
        packages={"numpy": "1", "scipy": "2"},
    )
    assert campaign.differences(first, other) == [
        "touchstone 9", "commit b", "python 4", "platform P", "cpu C", "compiler cc", "numpy 1",
        "pyomo absent", "scipy 2",
    ]  # fmt: skip
    same, far = ran("same"), replace(ran("far"), provenance=other)
    found = campaign.provenance(report(same, far, title="x"))
    assert not unsaid(found.said, "1 of 2 runs come from elsewhere")
    assert [(run.pipeline, link, len(differs)) for run, link, differs in found.values["runs"]] == [
        ("same", "pages/three_cart--same.html", 0),
        ("far", "pages/three_cart--far.html", 9),
    ]
    assert "none of 1 run come" in campaign.provenance(report(same)).said
    assert campaign.provenance(report(far, same)).values["first"] is other, (
        "without a campaign the first run's"
    )
    assert campaign.provenance(report()) is None
    assert campaign.provenance(report(title="x")).values["first"] == first


def test_sizes_once_a_method_and_those_that_differ():
    size = ModelSize(unknowns=5, equations=4)
    other = replace(size, unknowns=9)
    told = report(
        ran("a", size=size, paper_size=size), ran("b"), ran("a", size=size, paper_size=size),
        ran("c", size=size, paper_size=size), ran("a", size=other, paper_size=size),
        ran("d", size=size, paper_size=size, of=factory.scene("hill")),
    )  # fmt: skip
    found = scene.model(told, told.scenes[0])
    assert [(method, item.unknowns) for method, item, _ in found.values["sizes"]] == [
        ("a", 5),
        ("c", 5),
        ("a", 9),
    ]


@pytest.mark.parametrize(
    ("ours", "theirs", "same"),
    [
        ((5, 4), (5, 4), "yes"), ((9, 4), (5, 4), "no"), ((5, 9), (5, 4), "no"),
        ((5, 4), (9, 4), "no"), ((5, 4), (5, 9), "no"), ((5, 4), (4, 5), "no"),
    ],
)  # fmt: skip
def test_sizes_say_whether_they_are_those_on_paper(
    ours: tuple[int, int], theirs: tuple[int, int], same: str
):
    size, paper = (ModelSize(unknowns=n, equations=m) for n, m in (ours, theirs))
    told = report(ran("a", size=size, paper_size=paper))
    found = scene.model(told, told.scenes[0])
    (row,) = re.findall(
        r'<tr><th scope="row">a</th>.*?</tr>',
        Templates().render(found.template, section=found, **found.values),
    )
    numbers = [
        str(value) for value in (size.unknowns, paper.unknowns, size.equations, paper.equations)
    ]
    assert re.findall(r"<td[^>]*>(.*?)</td>", row) == [*numbers, same]


def test_the_index_names_scenes_with_their_best_plan_and_other_pages():
    told = report(
        ran("dear", cost=200.0), ran("cheap", cost=100.0),
        ran("wrong", cost=1.0, verdict="violates"), ran("idle", verdict="not applicable"),
        ran("unpriced", cost=None), ran("none", verdict="no plan", of=factory.scene("hill")),
        ran("free", verdict="consistent", of=factory.scene("hill")),
    )  # fmt: skip
    page = section.Section("sweeps", "Sweeps", "sweeps.html", said="Two sweeps.")
    found = overview.index(told, [("sweep", page)])
    assert found is not None
    assert [(scene.name, *rest) for scene, *rest in found.values["scenes"]] == [
        ("three_cart", "pages/scene-three_cart.html", 3, 4, "cheap, cost 100.00"),
        ("hill", "pages/scene-hill.html", 0, 1, ""),
    ]  # fmt: skip
    assert found.values["pages"] == [("pages/sweep.html", "Sweeps", "Two sweeps.")]
    assert overview.index(report(single=True), [("sweep", page)]).values["pages"] == [
        ("#sweeps", "Sweeps", "Two sweeps.")
    ]
    assert overview.index(report(), []) is None
    assert overview.index(report(ran("one")), []) is not None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "0.01 s is stable … is 0.75, with left and right closed; … below 0.19 s."),
        ({"contacts": (), "largest_step": None}, "is 0.75, with no contact closed; … at any step."),
        ({"growth": 3.5}, "left and right closed, the motion itself grows at 3.5/s"),
        ({"largest_step": 0.01}, "Past its stability limit: scene bank: … below 0.01 s"),
        ({"scene": "hill"}, ""),
    ],
)  # fmt: skip
def test_what_was_known_of_a_time_step(changes: dict, said: str):
    known = {
        "scene": "bank", "digest": "", "step": 0.01, "radius": 0.75, "contacts": ("left", "right"),
        "growth": 0.0, "largest_step": 0.19,
    }  # fmt: skip
    found = scene.time_step(
        report(time_steps=(from_data(TimeStepRecord, known | changes),)), "bank"
    )
    assert not unsaid(found, said)
    assert bool(said) == bool(found)
    assert scene.time_step(report(), "bank") == ""


DIGEST = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("key", "name", "run_link", "scene_link"),
    [
        ("plain", "bank", "bank--one.html", "scene-bank.html"),
        (DIGEST, "three_cart-2", "three_cart-2--one.html", "scene-three_cart-2.html"),
        (DIGEST, "a" * 80, f"{'a' * 80}--one.html", f"scene-{'a' * 80}.html"),
        ("a b", "a/b", "a-b--one.html", "scene-c14cddc033f64b9d.html"),
        (DIGEST, "", "unnamed--one.html", "scene-e3b0c44298fc1c14.html"),
    ],
)  # fmt: skip
def test_links_lead_to_pages_or_to_anchors(key: str, name: str, run_link: str, scene_link: str):
    where = factory.scene(name)
    other, run = ran("other"), replace(ran("one", of=where), key=key)
    told, single, beside = (
        report(other, run),
        report(other, run, single=True),
        report(other, run, at=""),
    )
    assert (told.link(run), single.link(run), beside.link(run)) == (
        f"pages/{run_link}",
        "#run-2",
        run_link,
    )
    assert (told.scene_link(where), single.scene_link(where)) == (f"pages/{scene_link}", "#scene-2")
    assert told.scene_anchor(where) == "scene-2"
    assert (told.page_link("sweeps"), told.page_link("sweeps", "one"), single.page_link("sweeps"),
            single.page_link("sweeps", "one")) == (
        "pages/sweeps.html", "pages/sweeps.html#one", "#sweeps", "#one",
    )  # fmt: skip
    assert [row.run.pipeline for row in told.rows_of_scene(where)] == ["one"]


def test_what_is_said_before_anything_else():
    from reports.pages.overview import notices

    lost = tuple(
        Unreadable(f"file {place}", why)
        for place, why in enumerate(("it is cut; see there.", "it is old.", "it is old."))
    )
    none = Stored(None, ())
    assert [
        part in " ".join(notices(Report(none)))
        for part in ("own record is missing", "No run is stored here yet")
    ] == [True, True]
    told = Stored(factory.campaign([], quick=True), (ran("a"),), lost, ("gone",), 2)
    missing, unread, foreign, quick = notices(Report(told))
    assert not unsaid(missing, "1 run … no stored record yet")
    assert not unsaid(unread, "3 files could not be read: of 2 of them it is old.")
    assert not unsaid(foreign, "2 stored runs … another campaign")
    assert not unsaid(quick, "a quick campaign")
    one = Stored(factory.campaign([]), (ran("a"),), lost[:1], ("gone", "lost"), 1)
    missing, unread, foreign = notices(Report(one))
    assert not unsaid(missing, "2 runs … have no stored record yet")
    assert not unsaid(unread, "1 file could not be read: it is cut, see there.")
    assert not unsaid(foreign, "1 stored run … belongs to another campaign")


def test_scenes_stand_in_the_order_of_the_campaign_however_their_runs_are_mixed():
    hill, bank = factory.scene("hill", "first"), factory.scene("bank")
    told = report(ran("a", of=hill), ran("b", of=bank), ran("c", of=factory.scene("hill", "later")))
    assert [(one.name, one.title) for one in told.scenes] == [
        ("hill", "first"),
        ("bank", bank.title),
    ]


def test_every_phase_has_its_words_and_its_group():
    """A second copy of the table."""
    groups = {
        "starting": {"start": "interpreter", "imports": "imports", "scene": "reading the scene",
                     "opening": "opening methods"},
        "compiling": {"compile": "compiling the scene", "fmu_build": "building the FMU"},
        "modelling": {"build": "building models", "translate": "translating models"},
        "evaluating": {"evaluate": "functions and derivatives"},
        "linear algebra": {"linear_algebra": "linear algebra of solvers"},
        "judging": {"certificate": "certificates", "replay": "replaying",
                    "survey": "trying plans in perturbed worlds"},
        "other": {"shared": "sharing stages with other runs", "solve_rest": "solving otherwise",
                  "writing": "writing files", "record": "the record"},
    }  # fmt: skip
    assert {
        phase: (words, group) for group, phases in groups.items() for phase, words in phases.items()
    } == campaign.PHASES


def test_a_scene_and_its_model():
    equations = (
        EquationRecord(caption="one", mathml="<math><mi>k</mi></math>"),
        EquationRecord(caption="bad", mathml="<p>no</p>"),
    )
    paper, hill = replace(factory.scene(), equations=equations), factory.scene("hill")
    size = ModelSize(unknowns=5, equations=4)
    told = report(ran("a", of=paper, size=size, paper_size=size), ran("b", of=hill))
    first, second = scene.build(told, paper), scene.build(told, hill)
    assert (first.anchor, first.title, first.values["model"], first.values["shown"]) == (
        "scene-1",
        "The scene three_cart",
        "model-1",
        None,
    )
    assert (second.anchor, second.title, second.values["model"]) == (
        "scene-2",
        "The scene hill",
        "model-2",
    )
    found = scene.model(told, paper)
    assert (found.anchor, found.title) == ("model-1", "Equations and quantities of three_cart")
    assert found.values["equations"] == [
        ("one", "<math><mi>k</mi></math>", "<math><mi>k</mi></math>"),
        ("bad", None, "<p>no</p>"),
    ]
    assert (found.values["sizes"], found.values["time_step"]) == ([("a", size, size)], "")
    assert scene.model(told, hill).values["sizes"] == []
    known = TimeStepRecord(
        scene="hill",
        digest="",
        step=0.01,
        radius=0.75,
        contacts=(),
        growth=0.0,
        largest_step=math.inf,
    )
    told = report(ran("b", of=hill), time_steps=(known,))
    assert (
        scene.model(told, hill).values["time_step"].startswith("The time step of 0.01 s is stable")
    )


def test_the_command_line_writes_the_pages_or_one_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    from reports import __main__ as command
    from reports.load import ReportError

    monkeypatch.setattr(command, "write_report", lambda folder: f"pages of {folder}")
    monkeypatch.setattr(command, "write_single", lambda folder: f"one file of {folder}")
    for words, code, said in (
        (["a"], 0, "pages of a\n"), (["a", "--single-file"], 0, "one file of a\n"),
        (["--single-file", "a"], 0, "one file of a\n"), ([], 2, ""), (["a", "b"], 2, ""),
        (["--other"], 2, ""), (["--single-file"], 2, ""),
    ):  # fmt: skip
        assert command.main(words) == code, words
        out, err = capsys.readouterr()
        assert (out, "usage: python -m reports [--single-file] DIR" in err) == (said, code == 2)

    def fail(folder: object) -> None:
        raise ReportError(f"{folder}: there is no such folder")

    monkeypatch.setattr(command, "write_report", fail)
    assert command.main(["a"]) == 2
    assert capsys.readouterr() == ("", "a: there is no such folder\n")
