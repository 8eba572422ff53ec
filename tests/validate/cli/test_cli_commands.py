"""The command line as a user meets it: help, lists, mistakes, exit codes."""

import importlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from wording import unsaid

from formulations.pipelines import pipeline_names
from models.catalog import load_scene
from models.trajectory import Trajectory, uniform_grid, write_csv
from reports.rule import RESULTS, RULE
from validate.cli.group import _COMMANDS, run

PLUGIN = ("--plugin", "campaign_fakes:PLUGIN")
FAKES = (*PLUGIN, "--scene", "three_cart")
GOOD = (*FAKES, "-k", "only_good")


@pytest.fixture
def in_here(tmp_path, monkeypatch, capfd):
    """in_here("al") -> (exit code, stdout, stderr) of the command in this process.

    What it does to signals is undone.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}

    def called(*arguments: str) -> tuple[int, str, str]:
        capfd.readouterr()
        return run(arguments), *capfd.readouterr()

    yield called
    for number, handler in before.items():
        signal.signal(number, handler)


def test_help_shows_examples_and_exit_codes(cli):
    overview = cli("--help")
    assert overview.returncode == 0
    assert not unsaid(
        overview.stdout, "Examples:", "Exit codes:", "130", "all", "list", "report", "replay", "fmu"
    )
    for name in _COMMANDS:
        with click.Context(
            importlib.import_module(f"validate.cli.{name}").command, info_name=name
        ) as context:
            text = context.get_help()
            assert "None" not in text
        assert "xample" in text, name
        assert "Exit codes:" in text, name
    words = " ".join(cli("all", "--help").stdout.split())
    assert "A campaign fails (exit code 1) if" in words
    assert all(sentence in words for sentence in (*RULE, *RESULTS))


def test_list_names_everything(cli):
    data = json.loads(cli("list", "--json").stdout)
    assert "three_cart" in [item["name"] for item in data["scenes"]]
    assert [item["name"] for item in data["pipelines"]] == list(pipeline_names())
    plain = cli("list").stdout
    assert all(name in plain for name in pipeline_names())


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("name", sorted(_COMMANDS))
def test_a_command_imports_by_itself(cli_environment, name: str):
    """In a process of its own: an import that misses another's, or goes in a circle, shows where nothing else was imported before."""
    command = [sys.executable, "-m", "validate", name, "--help"]
    done = subprocess.run(command, capture_output=True, text=True, env=cli_environment, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert name in done.stdout.splitlines()[0]


SOLVERS = {"torch", "pyomo", "cyipopt", "scipy", "sksundae"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "spared"),
    [
        (("--help",), {"numpy", "sympy", "pydantic"}),
        (("list",), {"numpy", "sympy", "pydantic", "tempfile", "hashlib"}),
        (
            ("show", "nothing", "--in", "nowhere/at_all"),
            {"numpy", "psutil", "sympy", "fmpy", "models.scene"},
        ),
        (
            ("all", "--scene", "two_body_collision", "-k", "no_such_name"),
            {"numpy.f2py", "rich", "fmpy"},
        ),
        (
            ("replay", "plan.csv", "--scene", "two_body_collision"),
            {"pydantic", "models.results.stored", "h5py", "numpy.ma", "numpy.f2py", "unittest"},
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
@pytest.mark.process
def test_a_command_imports_what_it_needs(cli_environment, tmp_path, arguments, spared):
    """In a process of its own, as a user's: what `cli` forks has imported all of it before."""
    scene, plan = load_scene("two_body_collision"), tmp_path / "plan.csv"
    times = uniform_grid(scene.task.step, scene.task.steps)
    still, none = np.zeros((len(times), scene.nq)), np.zeros((len(times) - 1, 1))
    write_csv(plan, Trajectory(t=times, q=still, v=still, u=none[:, :0], lam=none), scene)
    words = [str(plan) if word == plan.name else word for word in arguments]
    command = [sys.executable, "-X", "importtime", "-m", "validate", *words]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=cli_environment,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    imported = {
        line.rpartition("|")[2].strip()
        for line in done.stderr.splitlines()
        if line.startswith("import time:")
    }
    assert "validate.cli.group" in imported
    assert not imported & (SOLVERS | spared), done.stderr[-500:]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("al",), "did you mean all?"), (("frobnicate",), "there are all, run, new, list"),
        (("show", "nothing", "--in", "nowhere/at_all"), "no campaign in this folder"),
        (("run",), "give a campaign file"),
        (("run", "nowhere.toml"), "No such file"),
        (("all", *FAKES, "--lf", "--out", "nowhere/at_all"), "no campaign in this folder"),
        (("all", "--retry", "-1"), "-1 is not in the range"),
        (("all", "--quik"), "Did you mean '--quick'?"),
        (("all", "-j", "0"), "0 is not in the range x>=1"),
        (("all", "-j", "two"), "'two' is not a valid integer"),
        (("all", "--time-limit", "-1"), "not in the range x>0"),
        (("all", "--time-limit", "nan"), "not a finite number"),
        (("all", *FAKES, "-k", "good and"), "a name is missing at its end"),
        (("all", *FAKES, "--quick", "-k", "only_good"), "--quick leaves out all that"),
        (("all", "-k", ""), "a name is missing"),
        (("all", "-k", "strict", "-k", "FMU and not a"),
         "-k is given 2 times; join what is meant in one: -k '(strict) or (FMU and not a)'"),
         (("all", "--scene", "tree_cart"), "did you mean three_cart?"),
        (("all", "--scene", "nowhere/at_all.py"), "there is no such file"),
        (("all", "--plugin", "no_such_module:PLUGIN"), "cannot be imported"),
        (("all", "--plugin", "campaign_fakes:NOTHING"), "campaign_fakes has no NOTHING"),
        (("report", "nowhere/at_all"), "no campaign in this folder"),
        (("replay", "plan.csv"), "give either --scene or --fmu"),
        (("replay", "no_plan.csv", "--scene", "three_cart"), "it cannot be read"),
        (("fmu", "three_cart"), "missing option '-o'"),
        (("fmu", "three_kart", "-o", "x.fmu"), "did you mean three_cart?"),
        (("fmu", "three_cart", "-o", "x.ssp"), "only --coupled writes an .ssp; call it x.fmu"),
        (("fmu", "three_cart", "--coupled", "-o", "x.fmu"),
         "--coupled writes an .ssp; call it x.ssp"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence_and_exit_code_2(in_here, arguments, words):
    code, stdout, stderr = in_here(*arguments)
    assert code == 2
    assert words in stderr
    assert stderr.startswith("error: ")
    assert len(stderr.splitlines()) == 1
    assert stdout == ""


@pytest.mark.slow
def test_a_mistake_ends_the_process_so_too(cli):
    done = cli("all", *FAKES, "-k", "only_goood")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ")
    assert "'only_goood' is in no name; near are only_good" in done.stderr
    assert len(done.stderr.splitlines()) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("SCENE = 3", "must define SCENE"),
        ("import nothing_of_that_name", "ModuleNotFoundError"),
        ("def broken(:", "SyntaxError"),
        (
            "from models.scene import Parameter\nimport sympy as sp\nParameter(symbol=sp.Symbol('m'), value=1.0, unit='')",
            "the unit is missing",
        ),
    ],
)
def test_a_scene_file_with_a_mistake_is_named(in_here, tmp_path, text, words):
    path = tmp_path / "own_scene.py"
    path.write_text(text)
    code, _, stderr = in_here("all", "--scene", str(path))
    assert code == 2
    assert words in stderr
    assert str(path) in stderr
    assert len(stderr.splitlines()) == 1


def test_no_command_shows_help(cli):
    done = cli()
    assert done.returncode == 2
    assert "Usage:" in done.stderr


@pytest.mark.slow
def test_out_that_is_a_file(cli, tmp_path):
    (tmp_path / "taken").write_text("mine")
    done = cli("all", *GOOD, "--out", str(tmp_path / "taken"))
    assert done.returncode == 2
    assert "there is a file of that name" in done.stderr
    assert (tmp_path / "taken").read_text() == "mine"


@pytest.mark.slow
def test_what_is_not_a_campaign_s_is_not_replaced(cli, tmp_path):
    """Nor is a folder made where only what failed before is asked for."""
    (tmp_path / "checks.csv").write_text("mine")
    done = cli("all", *GOOD, "--out", str(tmp_path))
    assert done.returncode == 2
    for part in (str(tmp_path), "no campaign", "checks.csv", "folder that is new"):
        assert part in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["checks.csv"]
    assert (tmp_path / "checks.csv").read_text() == "mine"
    new = tmp_path / "new"
    done = cli("all", *GOOD, "--last-failed", "--out", str(new))
    assert (done.returncode, new.exists()) == (2, False)
    assert "no campaign in this folder" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["/proc/nothing_goes_here", "/dev/null/below"])
def test_out_that_cannot_be_written(cli, folder):
    done = cli("all", *GOOD, "--out", folder)
    assert done.returncode == 3
    assert "cannot write" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
def test_a_full_disk_is_one_sentence(cli, cli_environment, tmp_path):
    """A limit on the size of files stands for the disk's end: the record of a cell does not fit, log and request do."""
    arguments = [sys.executable, "-m", "validate", "all", *GOOD, "--out", str(tmp_path / "out")]
    cli("all", *GOOD, "--out", str(tmp_path / "before"))  # so that the scene is compiled already
    done = subprocess.run(
        ["sh", "-c", 'ulimit -f 12; exec "$@"', "sh", *arguments],
        capture_output=True,
        text=True,
        env=cli_environment,
        check=False,
    )
    assert done.returncode == 3
    (sentence,) = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert "written" in sentence or "cannot write" in sentence
    assert os.listdir(tmp_path / "out" / "runs") == []


@pytest.mark.slow
def test_no_compiler(cli, tmp_path):
    done = cli("all", *GOOD, "--out", str(tmp_path / "out"), CC="no_such_compiler")
    assert done.returncode == 3
    assert "no_such_compiler" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_an_unexpected_error_is_one_sentence_and_its_traceback_is_kept(cli, tmp_path):
    command = (
        "all",
        "--plugin",
        "campaign_fakes:BROKEN",
        "--scene",
        "three_cart",
        "--out",
        str(tmp_path / "out"),
        "-k",
        "only_good",
    )
    broken = cli(*command, TMPDIR=str(tmp_path))
    assert broken.returncode == 1
    (last,) = [line for line in broken.stderr.splitlines() if line.startswith("error:")]
    assert "RuntimeError: the report room is on fire" in last
    log = Path(last.split("the traceback is in ")[1].split(". Please")[0])
    assert "Traceback" in log.read_text()
    shown = cli(*command, TOUCHSTONE_DEBUG="1")
    assert "Traceback" in shown.stderr


@pytest.mark.parametrize(
    ("missing", "group"),
    [
        ("click", "validate.cli.group"),
        ("numpy", "validate.cli.group"),
        ("click", "benchmarks.commands"),
    ],
)
def test_a_python_without_what_touchstone_needs_says_so(missing, group):
    program = f"import sys; sys.modules[{missing!r}] = None; sys.argv = ['it', 'all']; from validate.__main__ import main; main({group!r})"
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (3, "")
    told = " ".join(done.stderr.split())
    assert told.startswith(f"error: {missing}, which touchstone needs, is not installed in ")
    assert "README.md" in told
    assert "pip install -e ." in told


@pytest.mark.slow
def test_a_scene_of_ones_own_by_path(cli, tmp_path):
    source = Path(__file__).parents[2] / "scenes" / "oscillator.py"
    out = tmp_path / "out"
    done = cli(
        "all", *PLUGIN, "-k", "only_good", "--scene", os.path.relpath(source), "--out", str(out)
    )
    assert done.returncode == 0, done.stderr
    assert "oscillator" in done.stdout
    assert (
        (out / "results.csv")
        .read_text()
        .splitlines()[1]
        .startswith("oscillator,only_good,1,good,,solved,")
    )


@pytest.mark.slow
def test_data_on_stdout_progress_on_stderr(cli, tmp_path):
    done = cli("all", *FAKES, "--quick", "--json", "--out", str(tmp_path))
    data = json.loads(done.stdout)
    assert [row["stage"] for row in data["results"]] == [1, 2, 3]
    assert data["exit_code"] == done.returncode == 0
    assert "three_cart x only_good" in data["left_out"]
    assert done.stderr.splitlines()[0] == "0 stored, 1 to run"
    assert json.loads((tmp_path / "campaign.json").read_text())["left_out"] == data["left_out"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plugin", "words"),
    [
        ("STRICT", "violates - the fake judge is strict"),
        ("STUMBLING", "undecided - the judge ended with"),
    ],
)
def test_a_direct_plan_that_does_not_hold_fails(cli, tmp_path, plugin, words):
    done = cli(
        "all",
        "--plugin",
        f"campaign_fakes:{plugin}",
        "--scene",
        "three_cart",
        "--out",
        str(tmp_path),
        "-k",
        "only_good or soft_alone",
    )
    assert done.returncode == 1
    failures = [line for line in done.stdout.splitlines() if line.startswith("fails: ")]
    assert len(failures) == 2, (
        "the indirect cell is expected to violate, but then none of the scene holds"
    )
    assert f"three_cart x only_good: {words}" in failures[0]
    assert "three_cart: no run holds (only_good solved" in failures[1]


@pytest.mark.slow
def test_a_limit_on_no_figure_is_said_before_anything_runs(cli, tmp_path: Path):
    path = tmp_path / "misspelt.py"
    path.write_text(
        "from dataclasses import replace\nfrom models.catalog import load_scene\nfrom models.scene import Limit\n"
        "SCENE = replace(load_scene('three_cart'), name='misspelt', limits=(*load_scene('three_cart').limits, Limit(metric='defct', value=1.0, reason='')))\n",
        encoding="utf-8",
    )
    done = cli("all", *GOOD, "--scene", str(path), "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "scene misspelt: there is a limit on 'defct'" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_campaign_of_refusals_claims_nothing(cli, tmp_path):
    done = cli(
        "all",
        "--scene",
        "bouncing_mass",
        "-k",
        "softplus_dc+strict",
        "--out",
        str(tmp_path / "refused"),
    )
    assert done.returncode == 0
    assert "no method applies to its scene" in done.stdout
    assert "holds" not in done.stdout


@pytest.mark.parametrize("code", [0, 3])
def test_exit_handlers_run_before_the_process_ends(code: int, cli_environment):
    """The process ends without taking its modules apart.

    What a command registered runs, what it wrote arrives, its exit code stays.
    """
    script = f"""
import atexit, sys
from validate import __main__
from validate.cli import group

def command(*_):
    atexit.register(print, "handled", end="")
    print("written", end=" ")
    return {code}

group.run = command
__main__.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env=cli_environment,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, "written handled", "")


def test_an_exception_nobody_caught_ends_as_python_ends(cli_environment):
    script = "from validate import __main__; from validate.cli import group; group.run = None; __main__.main()"
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env=cli_environment,
        check=False,
    )
    assert done.returncode == 1
    assert "TypeError" in done.stderr


@pytest.mark.slow
def test_a_campaign_ends_with_findings_and_failures_by_cause(cli, tmp_path):
    words = ("all", *FAKES, "--out", str(tmp_path), "-j", "1")
    done = cli(*words, "-k", "only_raises or only_exit_seven or only_good")
    lines = done.stdout.splitlines()
    assert any(
        line.startswith("- ") and "runs that end with exact contact" in line for line in lines
    )
    (grouped,) = [line for line in lines if line.startswith("fails: 2 runs - No plan: crashed")]
    assert "three_cart x only_raises" in grouped
    assert "three_cart x only_exit_seven" in grouped
    assert not any(line.startswith("three_cart ") for line in lines), "no row a run"
    assert lines[-3:-1] == [
        f"report:  {tmp_path / 'report.html'}",
        f"results: {tmp_path / 'results.csv'}",
    ]
    assert lines[-1].startswith(f"again:   {sys.executable} -m validate all ")
    assert "so far: three_cart: " in done.stderr
    part = cli(*words, "-k", "only_good", "--table")
    assert part.returncode == 0, "of what was selected nothing failed"
    assert sum(line.startswith("three_cart ") for line in part.stdout.splitlines()) == 1
    assert not unsaid(part.stderr, "2 other runs and checks")
    rows = (tmp_path / "results.csv").read_text().splitlines()[1:]
    assert {row.split(",")[1] for row in rows} == {"only_raises", "only_exit_seven", "only_good"}


@pytest.mark.process
@pytest.mark.parametrize(
    "words",
    [
        ("fmu", "own.py", "-o", "./own.py"),
        ("replay", "plan.csv", "--scene", "three_cart", "--html", "plan.csv"),
        ("robust", "plan.csv", "--scene", "three_cart", "--csv", "plan.csv"),
        ("check", "model.fmu", "--junit", "model.fmu"),
        ("check", "model.fmu", "--html", "one.xml", "--junit", "one.xml"),
    ],
)  # fmt: skip
def test_no_command_begins_that_would_write_over_what_it_reads_or_writes_besides(
    cli, tmp_path, monkeypatch, words: tuple[str, ...]
):
    monkeypatch.chdir(tmp_path)
    for name in ("own.py", "plan.csv", "model.fmu"):
        (tmp_path / name).write_text("precious", encoding="utf-8")
    done = cli(*words)
    assert done.returncode == 2
    assert not unsaid(done.stderr, "named twice", "would be lost", "name another for")
    assert {
        path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()
    } == dict.fromkeys(("own.py", "plan.csv", "model.fmu"), "precious")


@pytest.mark.process
def test_an_empty_name_of_a_file_is_refused_before_the_work(cli):
    done = cli("check", "model.fmu", "--html", "")
    assert done.returncode == 2
    assert not unsaid(done.stderr, "--html", "names no file", "give its path")


@pytest.mark.process
@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("all", "--dry-run", "--out", "n" * 300), ("'nnn", "no names as long", "shorter")),
        (("report", "n" * 300), ("no names as long", "shorter")),
        (("all", "--plugin", ""), ("--plugin", "''", "cannot be imported")),
        (("all", "--plugin", "../own"), ("--plugin ../own", "cannot be imported")),
        (("all", "-k", "(" * 5000 + "strict" + ")" * 5000),
         ("-k '((((", "nested deeper", "fewer parentheses")),
        (("all", "-k", ("strict and " + "not " * 88 + "(") * 34 + "strict" + ")" * 34),
         ("-k 'strict and", "nested deeper", "fewer parentheses")),
        (("all", "--scene", "own.py"), ("own.py", "Own while it was read, line 2")),
    ],
)  # fmt: skip
def test_odd_words_are_told_in_a_sentence(
    cli, tmp_path, monkeypatch, words: tuple[str, ...], parts: tuple[str, ...]
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(
        "class Own(BaseException): pass\nraise Own('x')\n", encoding="utf-8"
    )
    done = cli(*words)
    assert done.returncode == 2
    assert not unsaid(done.stderr, *parts)
    assert [path.name for path in tmp_path.iterdir()] == ["own.py"]
