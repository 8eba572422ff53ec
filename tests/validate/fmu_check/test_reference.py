"""Reference solutions: the truth lies within their error bars, `check` finds those that are worse than they claim, and other readers read the files."""

from __future__ import annotations

import csv
import math
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner, Result
from fmpy.util import read_csv, read_ref_opt_file
from shell_fmu import FOREIGN, NO_EVENTS, RATE, SKIP_SLOPE, STATE, Foreign, build_shell
from wording import unsaid

from models.catalog import load_scene
from models.errors import TouchstoneError
from models.fmu import build_fmu
from validate.cli.reference import command
from validate.fmi.archive import FmuError
from validate.fmi.references import FOLDER, MANIFEST, Table, read_settings, read_table, table_text
from validate.fmu_check import FmuCheckRow, Status, check_fmu
from validate.fmu_check.reference import bars

pytestmark = pytest.mark.process
_CHECK = "stored results hold"
# x' = u: the integral of its input.
_INTEGRATOR = Foreign(
    name="integrator",
    macros="#define NX 1\n#define NZ 0\n#define NR 3\n#define NI 0\n#define SOLVER_STEP 0.1\n#define STATE(k) ((k) + 1)\n#define RATE(k) ((k) + 2)\n",
    code="static void start(Model *m) { (void)m; }\nstatic void calculate(Model *m) { m->r[2] = m->r[3]; }\n"
    + NO_EVENTS
    + SKIP_SLOPE,
    reals=(
        ("x", STATE, 'start="0"'),
        ("der(x)", RATE, 'derivative="2"'),
        ("u", 'causality="input" variability="continuous"', 'start="0"'),
    ),
    states=(2,),
    experiment='startTime="0" stopTime="2" stepSize="0.1"',
)


def _model(name: str) -> Foreign:
    return next(model for model in FOREIGN if model.name == name)


def _run(*arguments: object) -> Result:
    return CliRunner().invoke(command, [str(item) for item in arguments], standalone_mode=False)


def _written(fmu: Path) -> tuple[Table, Table]:
    """Values and bars beside an FMU."""
    texts = [
        fmu.with_name(f"{fmu.stem}{ending}").read_text(encoding="utf-8")
        for ending in ("_ref.csv", "_ref_error.csv")
    ]
    return read_table("values", texts[0]), read_table("bars", texts[1])


def _row(fmu: Path) -> FmuCheckRow:
    (row,) = [row for row in check_fmu(fmu, names=[_CHECK]).rows if row.name == _CHECK]
    return row


@pytest.mark.slow
def test_the_closed_form_lies_within_the_bars(tmp_path: Path):
    """x' = -x from 1 is exp(-t)."""
    fmu = build_shell(_model("dahlquist"), tmp_path)
    assert _run(fmu, "--step", "0.05").exception is None
    values, error = _written(fmu)
    off = np.abs(values.columns["x"][:, 0] - np.exp(-values.times))
    assert len(values.times) == 201
    assert (off <= error.columns["x"][:, 0]).all()
    assert 0.0 < error.columns["x"].max() < 1e-6


@pytest.mark.slow
def test_bars_hold_through_events(tmp_path: Path):
    """A ball dropped from 1 m that keeps 0.7 of its speed: the closed form of its first three flights."""
    fmu = build_shell(_model("bouncing_ball"), tmp_path)
    assert _run(fmu, "--stop-time", "1.5").exception is None
    values, error = _written(fmu)
    g, speed, begin, heights = 9.81, 0.0, 0.0, []
    fall = math.sqrt(2.0 / g)
    flights = [(begin, 1.0, 0.0)]
    begin, speed = fall, 0.7 * g * fall
    while begin < 1.5:
        flights.append((begin, 0.0, speed))
        begin, speed = begin + 2.0 * speed / g, 0.7 * speed
    for time in values.times:
        since, height, up = [flight for flight in flights if flight[0] <= time][-1]
        heights.append(height + up * (time - since) - 0.5 * g * (time - since) ** 2)
    assert (np.abs(values.columns["h"][:, 0] - heights) <= error.columns["h"][:, 0]).all()
    assert error.columns["h"].max() < 1e-6


@pytest.mark.slow
def test_inputs_are_lines_between_their_times_and_jump_where_a_time_is_there_twice(tmp_path: Path):
    """u = t up to 1, then 0: x = t^2/2, then 1/2."""
    fmu = build_shell(_INTEGRATOR, tmp_path)
    drive = tmp_path / "drive.csv"
    drive.write_text("time,u\n0,0\n1,1\n1,0\n2,0\n", encoding="utf-8")
    assert _run(fmu, "--input", drive).exception is None
    values, error = _written(fmu)
    want = np.where(values.times < 1.0, 0.5 * values.times**2, 0.5)
    assert (np.abs(values.columns["x"][:, 0] - want) <= error.columns["x"][:, 0] + 1e-15).all()
    assert read_table("in", (tmp_path / "integrator_in.csv").read_text(encoding="utf-8")).columns[
        "u"
    ].tolist() == [[0], [1], [0], [0]]


@pytest.mark.slow
def test_co_simulation_is_what_model_exchange_is_within_both_bars(tmp_path: Path):
    fmu = tmp_path / "cart.fmu"
    fmu.write_bytes(build_fmu(load_scene("three_cart"), "2.0").read_bytes())
    (tmp_path / "cart_in.csv").write_text("time,u1\n0,0\n0.5,40\n1,40\n", encoding="utf-8")
    runs = []
    for kind in ("ME", "CS"):
        assert (
            _run(fmu, "--type", kind, "--stop-time", "1", "--step", "0.02", "--overwrite").exception
            is None
        )
        runs.append(_written(fmu))
    (exchange, wide), (steps, narrow) = runs
    for name in ("q1", "v3"):
        assert (
            np.abs(exchange.columns[name] - steps.columns[name])
            <= wide.columns[name] + narrow.columns[name]
        ).all(), name
        assert 0.0 < narrow.columns[name].max() < 1e-2


@pytest.mark.slow
def test_what_no_step_and_no_tolerance_changes_has_no_bar(tmp_path: Path):
    """Its Co-Simulation has steps of its own: 2 % off, and nothing from outside tells."""
    done = _run(build_shell(_model("dahlquist"), tmp_path), "--type", "CS")
    assert "nothing tells how exact" in str(done.exception)
    assert "Model Exchange" in str(done.exception)
    assert not list(tmp_path.glob("*_ref*"))


@pytest.mark.slow
def test_what_becomes_no_number_is_no_reference(tmp_path: Path):
    broken = replace(
        _INTEGRATOR,
        name="broken",
        code=_INTEGRATOR.code.replace("= m->r[3];", "= m->r[3] > 0.5 ? 0.0 / 0.0 : m->r[3];"),
    )
    fmu = build_shell(broken, tmp_path)
    (tmp_path / "in.csv").write_text("time,u\n0,0\n1,1\n2,1\n", encoding="utf-8")
    done = _run(fmu, "--type", "CS", "--input", tmp_path / "in.csv")
    assert not unsaid(
        str(done.exception), "x … is nan at t = 0.6 s … no number … end the experiment before"
    )
    assert not list(tmp_path.glob("*_ref*"))


def test_bars_of_runs_that_do_not_come_nearer_are_all_they_are_apart():
    rows = np.zeros((9, 1))
    near = bars([rows + 1.01, rows + 0.01, rows])
    far = bars([rows + 1.01, rows - 1.0, rows + 0.9])
    assert near[4, 0] == pytest.approx(0.04)
    assert far[4, 0] == pytest.approx(4 * 2.01)


@pytest.mark.slow
def test_a_solution_in_the_fmu_is_tried_again_and_a_number_that_is_worse_is_named(tmp_path: Path):
    fmu, carrier = build_shell(_model("dahlquist"), tmp_path), tmp_path / "carrier.fmu"
    assert _run(fmu, "--step", "0.05", "-o", carrier).exception is None
    assert not list(tmp_path.glob("*_ref*"))
    assert _row(fmu).status is Status.NOT_OFFERED
    row = _row(carrier)
    assert (row.status, "within its error bars" in row.sentence) == (Status.PASSED, True), (
        row.sentence
    )
    with zipfile.ZipFile(carrier) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    name = f"{FOLDER}/dahlquist_ref.csv"
    lines = content[name].decode().splitlines()
    time, x = lines[41].split(",")
    assert time == "2.0"
    content[name] = "\n".join([*lines[:41], f"{time},{float(x) + 1e-5!r}", *lines[42:]]).encode()
    row = _row(_packed(tmp_path / "worse.fmu", content))
    assert row.status is Status.FAILED
    for words in (name, "x is 0.13534", "t = 2 s", "1e-05 off", "its error bars allow"):
        assert words in row.sentence, row.sentence


def _packed(path: Path, content: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "status", "words"),
    [
        ("time,x,y7\n0,1,1\n1,0.36,1\n", Status.FAILED, ["no variable 'y7'", "old.csv"]),
        ("time,x,xx\n0,1,\n1,0.36,\n", Status.FAILED, ["no variable 'xx'", "did you mean x?"]),
        ("time,x\n0,1\n1,oops\n", Status.FAILED, ["line 3", "'oops', no number"]),
        (
            "time,x\n0,1\n1,0.3487\n",
            Status.ADVICE,
            ["x is 0.3487 at t = 1 s", "0.36787944", "how exact"],
        ),
        ("time,x\n0,1\n1,7\n", Status.FAILED, ["x is 7 at t = 1 s", "plain Co-Simulation"]),
        ("time,x\n0,1\n1,0.367879441\n", Status.PASSED, ["2 times"]),
        (None, Status.ADVICE, ["names the result 'old.csv', which is not in the FMU"]),
    ],
)
def test_a_result_that_somebody_stored(
    tmp_path: Path, text: str | None, status: Status, words: list[str]
):
    """x' = -x in steps of 0.1 s gives 0.3487 at 1 s where the truth is 0.3679."""
    fmu = build_shell(_model("dahlquist"), tmp_path)
    manifest = f'<fmiReferences xmlns:l="http://fmi-standard.org/fmi-ls-manifest" {" ".join(f"""l:fmi-ls-{name}="a" """ for name in ("name", "version", "description"))}><Related source="old.csv" role="result"/></fmiReferences>'
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr(f"{FOLDER}/{MANIFEST}", manifest)
        if text is not None:
            archive.writestr(f"{FOLDER}/old.csv", text)
    row = _row(fmu)
    assert row.status is status, row.sentence
    for word in words:
        assert word in row.sentence, row.sentence


@pytest.mark.slow
def test_a_file_that_is_there_is_kept_unless_it_is_to_be_replaced(tmp_path: Path):
    fmu, precious = build_shell(_INTEGRATOR, tmp_path), tmp_path / "prec.csv"
    precious.write_text("precious\n")
    assert f"{precious} is there already; give --overwrite" in str(
        _run(fmu, "-o", precious).exception
    )
    assert precious.read_text() == "precious\n"
    drive = tmp_path / "integrator_in.csv"
    drive.write_text("time,u\n0,1\n2,1\n")
    assert _run(fmu).exception is None, "inputs beside the FMU are read, and not written"
    assert drive.read_text() == "time,u\n0,1\n2,1\n"
    for ending in ("_ref.csv", "_ref_error.csv", "_ref.opt"):
        (tmp_path / f"integrator{ending}").unlink()
    (other := tmp_path / "other.csv").write_text("time,u\n0,2\n2,2\n")
    assert f"{drive} is there already" in str(_run(fmu, "--input", other).exception)
    assert _run(fmu, "-o", precious, "--overwrite").exception is None
    assert zipfile.is_zipfile(precious)


@pytest.mark.parametrize(
    ("experiment", "options", "words"),
    [
        (
            'startTime="0" stopTime="2"',
            ("--step", "1e-12"),
            "a line every 1e-12 s makes 2e+12 lines of 2 s; a result has 5368709 at most: give a longer --step.",
        ),
        ('startTime="0" stopTime="2"', ("--step", "1e-320"), "makes inf lines"),
        ('startTime="0"', (), "it does not say when its experiment ends; give --stop-time."),
        (
            'startTime="1" stopTime="0"',
            (),
            "the experiment begins at 1 s, and cannot end at 0 s; give a --stop-time after",
        ),
        ('startTime="0" stopTime="INF"', (), "cannot end at inf s"),
        ('stopTime="2"', ("--stop-time", "0"), "begins at 0 s, and cannot end at 0 s"),
        ('stopTime="abc"', (), "DefaultExperiment has stopTime='abc', which is no number"),
        ('stopTime="2" tolerance="fine"', (), "tolerance='fine', which is no number"),
    ],
)
def test_an_experiment_that_is_none_is_refused_in_a_sentence(
    tmp_path: Path, experiment: str, options: tuple[str, ...], words: str
):
    fmu = build_shell(replace(_INTEGRATOR, experiment=experiment), tmp_path)
    error = _run(fmu, *options).exception
    assert isinstance(error, TouchstoneError)
    assert words in str(error)


@pytest.mark.slow
def test_other_readers_read_what_is_written(tmp_path: Path):
    """FMPy reads a cross-check.

    The manifest keeps what it named before, and a second writing adds nothing.
    """
    fmu = build_shell(_model("dahlquist"), tmp_path)
    assert _run(fmu).exception is None
    options = read_ref_opt_file(tmp_path / "dahlquist_ref.opt")
    assert options == {"StartTime": 0.0, "StopTime": 10.0, "StepSize": 0.02, "RelTol": 1e-4}
    assert read_csv(tmp_path / "dahlquist_ref.csv")["x"][-1] == pytest.approx(
        math.exp(-10.0), rel=1e-5
    )
    row = _row(fmu)
    assert (row.status, "dahlquist_ref.csv" in row.sentence) == (Status.PASSED, True), row.sentence
    assert "there already" in str(_run(fmu).exception)
    (tmp_path / "dahlquist_ref.csv").unlink()
    assert _run(fmu, "--cross-check").exception is None
    with (tmp_path / "dahlquist_cc.csv").open(encoding="utf-8") as file:
        assert next(csv.reader(file)) == ["time", "x"]
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr(
            f"{FOLDER}/{MANIFEST}",
            '<fmiReferences><Related source="model.mo" role="model"/></fmiReferences>',
        )
    assert _run(fmu, "-o", fmu).exception is None
    assert f"{fmu}: {FOLDER}/dahlquist_ref.csv is there already; give --overwrite" in str(
        _run(fmu, "-o", fmu, "--step", "1").exception
    )
    assert _run(fmu, "-o", fmu, "--overwrite").exception is None
    with zipfile.ZipFile(fmu) as archive:
        root = ElementTree.fromstring(archive.read(f"{FOLDER}/{MANIFEST}"))
        assert len(archive.namelist()) == len(set(archive.namelist()))
    assert [item.get("source") for item in root] == [
        "model.mo",
        "dahlquist_ref.csv",
        "dahlquist_ref_error.csv",
        "dahlquist_ref.opt",
        "dahlquist.exp",
    ]
    assert (
        root.get("{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-name")
        == "org.fmi-standard.fmi-ls-ref"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no table of numbers"),
        ("time,x\n0,1\n0,2,3\n", "line 3 has 3 cells"),
        ("time,x,x\n0,1,2\n", "'x' is there twice"),
        ("time,x\n1,1\n0,2\n", "after 1 comes 0"),
        ("time,x\n0,1 2\n1,3\n", "line 3, column 'x' has 1 numbers"),
        ("time,x\nnan,1\n", "no time"),
    ],
)
def test_a_table_that_is_none_is_refused_in_a_sentence(text: str, words: str):
    with pytest.raises(FmuError, match=words):
        read_table("table.csv", text)


def test_tables_keep_every_bit():
    table = Table(
        np.array([0.0, 1.0 / 3.0]), {"a[1,2]": np.array([[0.1, 1e-300], [2.0 / 3.0, -0.0]])}
    )
    again = read_table("again", table_text(table))
    assert again.times.tobytes() == table.times.tobytes()
    assert again.columns["a[1,2]"].tobytes() == table.columns["a[1,2]"].tobytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("StartTime, 0\nStopTime, 1\nStepSize, 0\n", "RelTol is missing"),
        ("StartTime, 1\nStopTime, 1\nStepSize, 0\nRelTol, 1e-4\n", "StopTime is 1, not after"),
        ("StartTime, 0\nStopTime, 1\nStepSize, -1\nRelTol, 1e-4\n", "StepSize is -1"),
    ],
)
def test_settings_that_are_none_are_refused_in_a_sentence(text: str, words: str):
    with pytest.raises(FmuError, match=words):
        read_settings("model_ref.opt", text)
