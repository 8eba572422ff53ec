"""What docs/extending.md adds - a scene, a method, a metric, a page, a judge - is what the package asks of its own, followed as it is printed."""

import csv
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from types import ModuleType

import pytest
from wording import unsaid

import formulations.methods
import formulations.pipelines
from formulations.method import Kind, Leg, Pipeline
from models.catalog import load_scene, scene_names
from models.errors import TouchstoneError, UnknownNameError
from reports.load import load
from tests.formulations import test_method_conformance as asked_of_methods
from tests.models import test_scene_bank as asked_of_scenes
from validate.tasks.plugins import DEFAULT, load_plugin

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
_FILE = re.compile(r"<!-- file: ([\w.]+) -->\n```\w+\n(.*?)```", re.DOTALL)
_INTO = re.compile(r"<!-- into: ([\w./]+) -->\n```\w+\n(.*?)```", re.DOTALL)
_COPIED = re.compile(r"\[([\w.]+)\]\(extending/\1\) to `([\w/]+)`")
_BELOW = re.compile(r"<!-- below: ([\w./]+): (.+?) -->\n```\w+\n(.*?)```", re.DOTALL)
FILES = dict(_FILE.findall(TEXT)) | {
    path.name: path.read_text(encoding="utf-8")
    for path in (ROOT / "docs" / "extending").glob("*.py")
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The files of the page, importable; what was imported from there is forgotten afterwards."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in FILES:
        sys.modules.pop(Path(name).stem, None)


@pytest.fixture
def in_the_package(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """The method of the page found by its file's name, as if it lay in formulations/methods."""
    methods = folder / "methods"
    methods.mkdir()
    shutil.copy(folder / "steady.py", methods)
    monkeypatch.setattr(formulations.pipelines, "_FOLDER", methods)
    monkeypatch.setattr(formulations.methods, "__path__", [str(methods)])
    yield
    sys.modules.pop("formulations.methods.steady", None)
    asked_of_methods.first.cache_clear()


def conformance(module: ModuleType, names: tuple[str, ...]) -> dict[str, Callable[[str], None]]:
    """The tests of a module that are asked of each of these names."""
    marked = {
        name: getattr(test, "pytestmark", ())
        for name, test in vars(module).items()
        if name.startswith("test_")
    }
    return {
        name: getattr(module, name)
        for name, marks in marked.items()
        if any(mark.args == ("name", names) for mark in marks)
    }


OF_SCENES = conformance(asked_of_scenes, scene_names())
OF_METHODS = conformance(asked_of_methods, asked_of_methods.ALL)


@pytest.mark.parametrize("test", OF_SCENES.values(), ids=OF_SCENES)
def test_the_scene_is_one_of_the_bank(folder: Path, test):
    test(str(folder / "slider.py"))


@pytest.mark.slow
@pytest.mark.parametrize("test", OF_METHODS.values(), ids=OF_METHODS)
def test_the_method_is_one_of_the_package(
    in_the_package: None, test, monkeypatch: pytest.MonkeyPatch
):
    for names in ("ALL", "PLANS"):
        monkeypatch.setattr(asked_of_methods, names, ("steady",))
    assert formulations.pipelines.method_names() == ("steady",)
    test("steady")


def test_conformance_is_asked():
    """Or the two tests above ask nothing."""
    assert len(OF_SCENES) >= 2
    assert len(OF_METHODS) >= 8


def test_a_file_with_a_method_is_a_plugin(folder: Path):
    plugin = load_plugin("steady")
    first, *others = plugin.pipelines_for(load_scene("three_cart"))
    assert (first.name, [leg.method for leg in first.legs]) == ("steady", ["steady"])
    assert others == [*DEFAULT.pipelines_for(load_scene("three_cart"))]
    assert plugin.load_method("steady").kind is Kind.DIRECT
    assert plugin.load_method("mpcc") is DEFAULT.load_method("mpcc")
    smooth = load_plugin("smooth_gd").pipelines_for(load_scene("three_cart"))[0]
    assert smooth == Pipeline(
        name="smooth_gd",
        title="Smooth inputs",
        legs=(Leg(method="smooth_gd", schedule=(1e-2,), options={"iterations": 500}),),
    )


@pytest.mark.parametrize(
    ("name", "text", "parts"),
    [
        ("empty_plugin", "", ("empty_plugin has no METHOD",)),
        (
            "soft_plugin",
            FILES["smooth_gd.py"].replace("PIPELINE =", "OTHER ="),
            ("smooth_gd needs eps", "define PIPELINE"),
        ),
        ("odd_plugin", "METHOD = 1", ("no METHOD", "formulations.method.Method")),
        ("odd_name", "PLUGIN = 1", ("odd_name has no", "METHOD")),
    ],
)
def test_a_plugin_that_is_none_is_refused(
    folder: Path, name: str, text: str, parts: tuple[str, ...]
):
    (folder / f"{name}.py").write_text(text, encoding="utf-8")
    with pytest.raises(UnknownNameError) as refused:
        load_plugin(name)
    assert not unsaid(refused.value, f"--plugin {name}", *parts)


@pytest.mark.parametrize("field", [field.name for field in fields(DEFAULT)])
def test_a_plugin_whose_parts_are_of_another_kind_is_refused(field: str):
    for wrong in (None, "strict", ("strict", 1), 3):
        with pytest.raises(
            TouchstoneError,
            match=rf"^Plugin: {field} is .*, but must be a .*; without it ours is used\.$",
        ):
            replace(DEFAULT, **{field: wrong})


@pytest.mark.slow
@pytest.mark.process
def test_the_metric_and_the_page_are_in_a_campaign(folder: Path):
    """In a copy of the sources, changed as the page says and in no other place: results.csv, the verdict, the report."""
    copy = folder / "copy"
    for name in ("models", "formulations", "validate", "reports"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.glob("touchstone*.py"):
        shutil.copy(path, copy)
    for name, place in _COPIED.findall(TEXT):
        shutil.copy(ROOT / "docs" / "extending" / name, copy / place)
    for place, text in _INTO.findall(TEXT):
        with (copy / place).open("a", encoding="utf-8") as file:
            file.write(f"\n\n{text}" if file.tell() else text)
    for place, line, added in _BELOW.findall(TEXT):
        text = (copy / place).read_text(encoding="utf-8")
        assert text.count(f"\n{line}\n") == 1, (place, line)
        (copy / place).write_text(
            text.replace(f"\n{line}\n", f"\n{line}\n{added}"), encoding="utf-8"
        )
    words = [
        sys.executable,
        "-m",
        "validate",
        "run",
        str(folder / "rate.toml"),
        "--out",
        str(folder / "out"),
    ]
    done = subprocess.run(
        words,
        cwd=copy,
        env=os.environ | {"PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in done.stderr, done.stderr
    assert done.returncode == 1, done.stdout + done.stderr
    with (folder / "out" / "results.csv").open(encoding="utf-8") as file:
        free, limited = csv.DictReader(file)
    assert (free["verdict"], limited["verdict"]) == ("holds", "violates")
    assert float(limited["input_rate"]) == float(free["input_rate"]) > 10.0
    stored = load(folder / "out")
    assert [
        run.stages[0].why.startswith("its inputs change by 19.1 N/s, limit 10 N/s")
        for run in stored.runs
    ] == [False, True]
    pages = {path: path.read_text(encoding="utf-8") for path in (folder / "out").rglob("*.html")}
    assert any("largest change of an input" in text for text in pages.values())
    sections = [
        found[0]
        for text in pages.values()
        for found in re.finditer(r'<section id="cheapest".*?</section>', text, re.DOTALL)
    ]
    assert ["542.56" in section for section in sections] == [True]
