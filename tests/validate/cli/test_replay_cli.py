"""`replay` on the command line: somebody's FMU by a map, equal names, and every mistake one sentence with its exit code."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign_fmu import COSIMULATION, FULL_MAP, build_foreign, foreign_plan, write_plan
from wording import unsaid

from models.catalog import load_scene
from models.fmu import build_fmu
from models.trajectory import Trajectory, uniform_grid, write_csv
from models.trajectory_netcdf import write_netcdf
from validate.cli.group import run

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli")
    build_foreign(folder / "cart.fmu")
    write_plan(folder / "plan.csv")
    (folder / "map.toml").write_text(FULL_MAP, encoding="utf-8")
    return folder


@pytest.fixture
def command(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    monkeypatch.chdir(folder)

    def call(*arguments: str) -> tuple[int, str, str]:
        code = run(["replay", *arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


def refused(answer: tuple[int, str, str], *parts: str) -> None:
    """In one sentence that says these."""
    code, out, err = answer
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert not unsaid(err, *parts)


def write(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_foreign_fmu_is_judged_by_its_map(command: Command, folder: Path):
    deep = FULL_MAP.replace("[start]", "depth = 0.2\n[start]")
    write(folder / "deep.toml", deep)
    code, out, _ = command(
        "plan.csv", "--fmu", "cart.fmu", "--map", "deep.toml", "--json", "--out", "told"
    )
    told = json.loads(out)
    metrics = {metric["name"]: metric for metric in told["metrics"]}
    assert (code, told["verdict"]) == (0, "holds")
    assert metrics["replay_error"]["value"] < 1e-7
    assert metrics["ghost_impulse"]["value"] < 0.1
    assert metrics["max_penetration"]["value"] == pytest.approx(
        foreign_plan()[:, 4].max() / 1000, rel=0.1
    )
    assert metrics["replay_terminal_position_error"]["value"] == pytest.approx(
        abs(foreign_plan()[-1, 1] - 0.2), abs=1e-6
    )
    assert metrics["max_penetration"]["limit"] == 0.2
    assert told["why"].startswith("holds for what this FMU shows (questions 1, 2, 3, 4, 5)")
    assert any("an FMU keeps its equations to itself" in text for text in told["not_asked"])
    assert not {"physics", "defect"} & set(metrics)
    answers = {item["number"]: item["answer"] for item in told["questions"]}
    assert answers | {6: "not asked", None: "not asked"} == answers
    # Its Co-Simulation has a step of its own that nobody can halve, so its distance from the
    # reference counts: 1e-8.
    assert told["replay"]["error"]["estimate"]["position"] < 1e-7
    assert sorted(path.name for path in (folder / "told").iterdir()) == ["replay.nc", "score.json"]
    assert json.loads((folder / "told/score.json").read_text()) == told


def test_a_gap_whose_sign_contradicts_the_force_decides_nothing(command: Command, folder: Path):
    """Told the right way round a contact of this depth holds.

    The other way round nobody knows how deep it is.
    """
    given = FULL_MAP.replace("[start]", "depth = 0.2\n[start]")
    for scale, code, word in (("0.001", 0, "holds"), ("-0.001", 1, "undecided")):
        turned = given.replace('"stop.gap", scale = 0.001', f'"stop.gap", scale = {scale}')
        found, out, _ = command(
            "plan.csv",
            "--fmu",
            "cart.fmu",
            "--map",
            write(folder / "turned.toml", turned),
            "--json",
        )
        told = json.loads(out)
        assert (found, told["verdict"]) == (code, word), told["why"]
    assert not unsaid(
        told["why"],
        "max_penetration",
        "contact stop",
        "gap is open in",
        "sign (scale)",
        "zero (offset)",
    )


def test_a_goal_whose_limits_the_map_waives_is_no_goal(command: Command, folder: Path):
    waived = FULL_MAP.replace("value = 1.0, reason", "waived = true, reason")
    assert waived != FULL_MAP
    code, out, _ = command(
        "plan.csv", "--fmu", "cart.fmu", "--map", write(folder / "waived.toml", waived)
    )
    assert code == 0
    assert "consistent for what this FMU shows" in out


def test_what_is_not_named_is_said_and_not_shown(command: Command, folder: Path):
    bare = '[inputs]\nF = { variable = "drive.force", scale = 0.001 }\n[positions]\nx = { variable = "body.pos", scale = 0.001 }\n'
    bare += '[contacts.stop]\nforce = "stop.push"\n[start]\n"body.pos" = 300\n"body.vel" = 2000\n[limits]\nghost_impulse = 1.0\nreplay_error = 1e-3\n'
    write_plan(folder / "short.csv", "t,x,F,lam_stop")
    code, out, _ = command(
        "short.csv", "--fmu", "cart.fmu", "--map", write(folder / "bare.toml", bare), "--json"
    )
    told = json.loads(out)
    metrics = {metric["name"]: metric for metric in told["metrics"]}
    assert (code, told["verdict"]) == (0, "consistent"), told["why"]
    assert not unsaid(
        told["why"], "consistent", "questions 1, 4)", "asks for nothing", "give it a [goal]"
    )
    assert (
        metrics["ghost_impulse"]["reason"]
        == metrics["missed_impulse"]["reason"]
        == "not every contact has a gap named."
    )
    for words in (
        "max_penetration: contact stop has no gap",
        "no [goal]",
        "no [task] duration",
        "ghost_impulse, missed_impulse: not every contact",
    ):
        assert any(words in text for text in told["not_asked"]), words
    assert metrics["replay_error"]["value"] < 1e-7
    assert metrics["replay_error"]["limit"] == pytest.approx(1e-3)


def test_a_plan_that_drives_no_input_is_judged_by_what_the_fmu_does_alone(
    command: Command, folder: Path
):
    bare = '[positions]\nx = { variable = "body.pos", scale = 0.001 }\n'
    bare += "[start]\n'body.pos' = 300\n"
    write_plan(folder / "idle.csv", "t,x")
    code, out, _ = command(
        "idle.csv", "--fmu", "cart.fmu", "--map", write(folder / "idle.toml", bare), "--json"
    )
    told = json.loads(out)
    assert (code, told["verdict"]) == (1, "violates")
    assert not unsaid(told["why"], "by its inputs", "departs from the plan by 0.302")


@pytest.mark.slow
def test_equal_names_need_no_map(command: Command, folder: Path):
    (folder / "own.fmu").write_bytes(build_fmu(load_scene("three_cart")).read_bytes())
    rows = [[0.01 * n, 2, 3, 4, 0, 0, 0, 1.0, -1.0] for n in range(6)]
    text = "t,q1,q2,q3,v1,v2,v3,u1,u3\n" + "\n".join(",".join(map(str, row)) for row in rows)
    code, out, _ = command(write(folder / "own.csv", text), "--fmu", "own.fmu")
    assert code == 0
    assert "the map names no [contacts]" in out
    assert not unsaid(out, "consistent", "(questions 1, 3, 4)", "asks for nothing")
    code, out, _ = command(
        write(folder / "own.csv", text.replace("1.0,-1.0", "9.0,-9.0")), "--fmu", "own.fmu"
    )
    assert code == 1
    assert not unsaid(out, "violates: ", "departs from the plan by 0.0109 m")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("[positions]", '[positions]\ny = "body.poss"'),
         "positions.y: … no variable 'body.poss' (near it: body.pos"),
        (("[goal]\nx", "[goal]\nxx"), "goal.xx: … no position or velocity … near it: x"),
        (("ghost_impulse", "ghost_impuls"),
         "limits.ghost_impuls: … no metric … near it: ghost_impulse"),
        (("scale = 0.001, unit = \"N\"", 'scale = "big", factor = 2'),
         "inputs.F.scale: it is … but must be a number"),
        (("\n[inputs]", 'internal_step = "body.pos"\n[inputs]'),
         "internal_step: 'body.pos' is no parameter of the FMU"),
        (("[goal]", "[goal"), "it is not TOML"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_map_is_one_sentence_with_its_path(
    command: Command, folder: Path, change: tuple[str, str], words: str
):
    assert change[0] in FULL_MAP
    answer = command(
        "plan.csv",
        "--fmu",
        "cart.fmu",
        "--map",
        write(folder / "wrong.toml", FULL_MAP.replace(*change)),
    )
    refused(answer, words, "wrong.toml")


def broken(plan: np.ndarray, row: int, column: int, value: float) -> np.ndarray:
    changed = plan.copy()
    changed[row, column] = value
    return changed


@pytest.mark.parametrize(
    ("columns", "plan", "words"),
    [
        ("t,x,v_x,F,lam_stop", broken(foreign_plan(), 3, 1, np.nan),
         "line 5, column 'x': 'nan' is not a finite number"),
        ("t,x,v_x,F,lam_stop", broken(foreign_plan(), 3, 3, np.inf),
         "line 5, column 'F': 'inf' is not a finite number"),
        ("t,x,v_x,F,lam_stop", broken(foreign_plan(), 3, 0, 0.0), "time must increase"),
        ("t,x,v_x", foreign_plan(), "the column 'F' is missing"),
        ("x,F", foreign_plan(), "the column 't' is missing"),
        ("t,x,x,F", foreign_plan(), "'x' appears twice"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_plan_is_one_sentence(
    command: Command, folder: Path, columns: str, plan: np.ndarray, words: str
):
    write_plan(folder / "wrong.csv", columns, plan)
    refused(command("wrong.csv", "--fmu", "cart.fmu", "--map", "map.toml"), words, "wrong.csv")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,x,F,y\n0,1,1,1\n1,1,1,1\n", "the column 'y' is unknown"),
        ("t,x,F,y\n0,1,1,1\n1,1,1,1\n", "ignore it (--ignore y)"),
        ("t,x,F\n0,1,1,1\n1,1,1\n", "line 2 has 4 cells … 3 columns"),
        ("t,x,F\n0,1,1\n1,,1\n", "line 3, column 'x': the cell is empty"),
        ("t,x,F\n0,1,1\n", "a header and at least two rows"),
        ("t [ms],x,F\n0,1,1\n1,1,1\n", "'t' is in 'ms', but 's'"),
        ("t,x [km],F\n0,1,1\n1,1,1\n", "in 'km', but 'body.pos' is in 'mm'; give a scale"),
    ],
)  # fmt: skip
def test_a_plan_of_the_wrong_form(command: Command, folder: Path, text: str, words: str):
    given = FULL_MAP.replace(', unit = "m" }\n[velocities]', " }\n[velocities]").replace(
        "scale = 0.001 }\n[velocities]", "scale = 1.0 }\n[velocities]"
    )
    refused(
        command(
            write(folder / "form.csv", text),
            "--fmu",
            "cart.fmu",
            "--map",
            write(folder / "form.toml", given),
        ),
        words,
    )


def test_a_unit_that_the_map_contradicts_is_refused(command: Command, folder: Path):
    text = "t,x [inch],F\n0,1,1\n1,1,1\n"
    answer = command(write(folder / "inch.csv", text), "--fmu", "cart.fmu", "--map", "map.toml")
    refused(answer, "positions.x", "column 'x' is in 'inch'", "map says 'm'")


@pytest.mark.parametrize("option", ["--time-limit", "--memory-limit"])
@pytest.mark.parametrize("number", ["nan", "inf"])
def test_a_limit_that_is_no_number_is_refused(command: Command, option: str, number: str):
    refused(command("plan.csv", "--fmu", "cart.fmu", option, number), "is not a finite number")


def test_a_scene_plan_with_another_unit_is_refused(command: Command, folder: Path):
    text = "t,q1 [mm],q2,q3,u1,u3\n0,2,3,4,0,0\n0.01,2,3,4,0,0\n"
    code, _, err = command(write(folder / "unit.csv", text), "--scene", "three_cart")
    assert code == 2
    assert not unsaid(err, "'q1' is in 'mm', but 'm'")
    near = text.replace("q1 [mm]", "q1").replace("u3", "u_3")
    code, _, err = command(write(folder / "near.csv", near), "--scene", "three_cart")
    assert (code, "did you mean 'u3'" in err) == (2, True)


@pytest.mark.slow
def test_a_plan_of_another_duration_does_not_hold(command: Command, folder: Path):
    """Until now a warning on stderr beside `holds`.

    The grid of a plan that declares no scheme is nobody's business.
    """
    text = "t,q1,q2,q3,u1,u3\n0,2,3,4,0,0\n0.5,2,3,4,0,0\n1,2,3,4,0,0\n"
    code, out, err = command(write(folder / "brief.csv", text), "--scene", "three_cart", "--json")
    told = json.loads(out)
    assert (code, told["verdict"], err) == (1, "violates", "")
    assert not unsaid(told["why"], "duration by 4 s", "limit 0.005 s", "lasts 1 s", "task 5 s")
    assert told["warnings"] == []
    declared = "# scheme: semi_implicit_euler\n" + text
    _, out, _ = command(write(folder / "brief.csv", declared), "--scene", "three_cart", "--json")
    (warning,) = json.loads(out)["warnings"]
    assert not unsaid(warning, "0.5 s lies past the stability limit")


@pytest.mark.slow
def test_a_plan_as_a_campaign_stores_it_is_the_same_plan(command: Command, folder: Path):
    """Metrics that nothing is asked of have no row, and a sentence with their reason."""
    scene = load_scene("two_body_collision")
    times = uniform_grid(scene.task.step, scene.task.steps)
    still = np.zeros((len(times), scene.nq))
    plan = Trajectory(
        t=times,
        q=still,
        v=still,
        u=np.zeros((len(times) - 1, 0)),
        lam=np.zeros((len(times) - 1, 1)),
    )
    write_netcdf(folder / "still.nc", plan, scene)
    write_csv(folder / "same.csv", plan, scene)
    (code, out, _), (same, told, _) = (
        command(name, "--scene", scene.name) for name in ("still.nc", "same.csv")
    )
    assert (code, out) == (same, told)
    assert out.startswith("violates: the plan starts 2 m/s away from the task's start")
    rows = re.findall(r"^ *\d?  (\w+) .*?(\w*)$", out, re.MULTILINE)
    assert ("start_error", "beyond") in rows
    assert not unsaid(out, "not asked: physics_scaled, defect, law_error: … no scheme.")
    assert not {"physics_scaled", "defect", "law_error"} & {name for name, _ in rows}


def test_files_that_are_not_there_or_no_zip(command: Command, folder: Path):
    for arguments, words in (
        (("plan.csv", "--fmu", "absent.fmu"), "there is no such file"),
        (("plan.csv", "--fmu", "plan.csv"), "it is not a zip file"),
        (("absent.csv", "--fmu", "cart.fmu", "--map", "map.toml"), "it cannot be read"),
        (("plan.csv", "--fmu", "cart.fmu", "--map", "absent.toml"), "it cannot be read"),
        (("plan.csv", "--fmu", "cart.fmu"), "the FMU has no variable 'x'"),
        (
            ("plan.csv", "--scene", "three_cart", "--fmu", "cart.fmu"),
            "give either --scene or --fmu",
        ),
        (("plan.csv", "--scene", "three_cart", "--map", "map.toml"), "--map belongs to --fmu"),
    ):
        code, out, err = command(*arguments)
        assert (code, out) == (2, ""), err
        assert not unsaid(err, words)


def test_a_misbehaving_fmu_leaves_a_verdict(command: Command, folder: Path):
    build_foreign(folder / "segfault.fmu", "segfault")
    code, out, _ = command(
        "plan.csv", "--fmu", "segfault.fmu", "--map", "map.toml", "--json", "--out", "crashed"
    )
    told = json.loads(out)
    assert (code, told["verdict"], told["replay"]["outcome"]) == (1, "undecided", "crashed")
    assert "SIGSEGV" in told["why"]
    assert (folder / "crashed/score.json").exists()


def test_a_cosimulation_that_does_not_heed_its_step_is_not_resolved(command: Command, folder: Path):
    """Its own step is 1e-3 s whatever is asked for: no run says how wrong it is, so no limit can be judged."""
    build_foreign(folder / "own_grid.fmu", kinds=COSIMULATION, defines=("OWN_GRID=1e-3",))
    code, out, _ = command("plan.csv", "--fmu", "own_grid.fmu", "--map", "map.toml", "--json")
    told = json.loads(out)
    assert (code, told["verdict"]) == (1, "undecided")
    assert told["replay"]["error"]["estimate"] is None
    assert "do not come together" in told["replay"]["message"]


@pytest.mark.slow
def test_html_is_the_page_of_a_run_for_a_plan_on_a_scene(command: Command, folder: Path):
    scene = load_scene("three_cart")
    rows = [[0.01 * n, 2, 3, 4, 0, 0, 0, 0.1, -0.1] for n in range(501)]
    write(
        folder / "still.csv",
        "t,q1,q2,q3,v1,v2,v3,u1,u3\n" + "\n".join(",".join(map(str, row)) for row in rows),
    )
    code, out, _ = command("still.csv", "--scene", "three_cart", "--html", "pages/still.html")
    page = (folder / "pages/still.html").read_text(encoding="utf-8")
    assert (code, out.partition(":")[0]) == (1, "violates")
    for part in (
        "still.csv",
        scene.title,
        "data-player",
        "violates",
        "replay_error",
        "Contact force, left",
        "replay still.csv --scene three_cart --html",
    ):
        assert not unsaid(page, part)
    assert "src=" not in page, "it needs nothing else"
    assert len(page.encode()) <= 300_000


def test_html_of_somebodys_fmu_shows_what_the_map_names(command: Command, folder: Path):
    """Under names of contacts and columns that files cannot have, too."""
    named = FULL_MAP.replace(
        "[contacts.stop]", '[contacts."stop/end"]\ncolumn = "lam_stop"'
    ).replace("[start]", "depth = 0.2\n[start]")
    code, _, err = command(
        "plan.csv",
        "--fmu",
        "cart.fmu",
        "--map",
        write(folder / "named.toml", named),
        "--html",
        "cart.html",
    )
    page = (folder / "cart.html").read_text(encoding="utf-8")
    assert code == 0, err
    assert "<canvas" not in page, "of an FMU nobody knows the bodies"
    assert not unsaid(
        page, "plan.csv", "Positions: plan dotted, replay solid", "Position error",
        "Contact force, stop_end", "Gap, stop_end", "Inputs of the plan",
        "for what this FMU shows",
    )  # fmt: skip


@pytest.mark.slow
def test_html_draws_nothing_of_a_plan_that_it_does_not_say(command: Command, folder: Path):
    inputs = "t,u1,u3\n" + "\n".join(f"{0.01 * n},0.1,-0.1" for n in range(501))
    command(write(folder / "inputs.csv", inputs), "--scene", "three_cart", "--html", "inputs.html")
    page = (folder / "inputs.html").read_text(encoding="utf-8")
    assert "The replay ends at q1" in page
    assert "The plan ends at" not in page
    assert "Position error" not in page


@pytest.mark.parametrize(
    ("target", "words"), [("told", "told"), ("plan.csv/page.html", "plan.csv")]
)
def test_a_page_that_cannot_be_written_is_one_sentence(
    command: Command, folder: Path, target: str, words: str
):
    (folder / "told").mkdir(exist_ok=True)
    code, out, err = command("plan.csv", "--fmu", "cart.fmu", "--map", "map.toml", "--html", target)
    assert code in (2, 3)
    assert (out, err.count("\n")) == ("", 1)
    assert not unsaid(err, words)
