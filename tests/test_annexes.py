"""Each annex can be removed: the rest keeps its contracts, its imports and a quick campaign."""

import ast
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("models", "formulations", "validate", "reports")
# Files of each annex. The first is its folder, with its README.md.
ANNEXES = {
    "mjcf": (
        "models/fmu/mjcf",
        "validate/cli/exports/mjcf.py",
        "tests/models/fmu/mjcf",
        "docs/mjcf.md",
        "docs/tutorial/robot.md",
    ),
    "coupled": (
        "models/fmu/coupled",
        "validate/cli/exports/coupled.py",
        "tests/models/fmu/coupled",
        "docs/cosimulation.md",
    ),
    "fmu_check": (
        "validate/fmu_check",
        "validate/tasks/fmu_checks.py",
        "validate/cli/check.py",
        "tests/validate/fmu_check",
        "docs/fmu_check.md",
        "docs/tutorial/fmu.md",
    ),
    "mpec": (
        "formulations/mpec",
        "formulations/ampl",
        "tests/formulations/mpec",
        "tests/formulations/ampl",
        "docs/mpec.md",
        "docs/mpec_sets.md",
        "docs/mpec_sets.csv",
        "docs/tutorial/mpec.md",
    ),
    "robustness": (
        "validate/judge/robustness",
        "validate/cli/robust.py",
        "reports/pages/robustness.py",
        "reports/templates/robustness.html",
        "tests/validate/judge/robustness",
        "docs/robustness.md",
    ),
    "engines": (
        "validate/judge/engines",
        "validate/cli/additions/engines.py",
        "validate/cli/truth.py",
        "reports/pages/simulators.py",
        "models/results/engines.py",
        "reports/templates/simulators.html",
        "reports/templates/truth.html",
        "tests/validate/judge/engines",
        "docs/engines.md",
        "docs/truth.md",
    ),
    "dask": ("validate/campaign/dask", "tests/validate/campaign/dask", "docs/cluster.md"),
}
# Tests of the documentation, which describes the annexes too.
_OF_DOCS = {Path("tests/test_docs.py"), Path("tests/test_site.py")}
_CONTRACT = "[[tool.importlinter.contracts]]"
# Import every module of the rooms, public name and command; print the number of modules. Packages
# of other projects may be missing.
_IMPORT_ALL = f"""
import importlib, pkgutil
import touchstone
from validate.cli.group import group, run
names = []
for room in {ROOMS!r}:
    package = importlib.import_module(room)
    names += [one.name for one in pkgutil.walk_packages(package.__path__, f"{{room}}.")]
names = [name for name in names if not name.endswith("__main__")]
for name in names:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name.partition(".")[0] in {ROOMS!r}:
            raise
for name in touchstone.__all__:
    getattr(touchstone, name)
for name in group.lazy:
    assert run([name, "--help"]) == 0
print(len(names))
"""


def files_of(tree: Path) -> list[str]:
    """Return the files of a checkout that git tracks or would add."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip("this is no git checkout")
    return [name for name in done.stdout.splitlines() if (tree / name).is_file()]


def copied(folder: Path) -> Path:
    """Return a copy of this checkout."""
    tree = folder / "tree"
    for name in files_of(ROOT):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, tree / name)
    return tree


def remove(tree: Path, annex: str) -> None:
    """Delete the files of an annex and its import contracts."""
    for name in ANNEXES[annex]:
        place = tree / name
        assert place.exists(), f"annex {annex}: {name} is missing; correct ANNEXES"
        shutil.rmtree(place) if place.is_dir() else place.unlink()
    settings = tree / "pyproject.toml"
    first, *contracts = settings.read_text(encoding="utf-8").split(_CONTRACT)
    kept = [text for text in contracts if f'name = "annex {annex}:' not in text]
    assert len(kept) < len(contracts), f"annex {annex} has no contract of its own"
    settings.write_text(_CONTRACT.join([first, *kept]), encoding="utf-8")


def called(tree: Path, *command: str | Path) -> str:
    """Return the output of a command in a tree; it must exit with 0."""
    done = subprocess.run(
        list(map(str, command)),
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree), "COLUMNS": "100"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def validate(tree: Path, *words: str) -> str:
    """Return the output of a command of touchstone in a tree."""
    return called(tree, sys.executable, "-m", "validate", *words)


def check_core(tree: Path) -> None:
    """Check contracts, imports and the commands that import no solver."""
    called(tree, Path(sys.executable).with_name("lint-imports"), "--no-cache")
    assert int(called(tree, sys.executable, "-c", _IMPORT_ALL).split()[-1]) > 200
    validate(tree, "list")
    validate(tree, "--help")


@pytest.mark.slow
@pytest.mark.parametrize("annex", ANNEXES)
def test_annex_removed_core_stays(annex: str, tmp_path: Path):
    tree = copied(tmp_path)
    remove(tree, annex)
    check_core(tree)
    out = tmp_path / "out"
    validate(tree, "all", "--quick", "--scene", "two_body_collision", "--out", str(out))
    assert (out / "report.html").is_file()


@pytest.mark.slow
def test_annexes_all_removed_quick_campaign_passes(tmp_path: Path):
    tree = copied(tmp_path)
    for annex in ANNEXES:
        remove(tree, annex)
    check_core(tree)
    validate(tree, "all", "--quick", "--out", str(tmp_path / "out"))
    assert (tmp_path / "out" / "report.html").is_file()


@cache
def imports_below(*rooms: str) -> dict[Path, set[str]]:
    """Return the modules, and the names in modules, that each file of some folders imports.

    Imports in functions and for type checkers count.
    """
    found: dict[Path, set[str]] = {}
    for path in sorted(path for room in rooms for path in (ROOT / room).rglob("*.py")):
        names = found.setdefault(path.relative_to(ROOT), set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def modules_of(annex: str) -> tuple[str, ...]:
    """Return the modules and packages of an annex."""
    paths = [Path(name) for name in ANNEXES[annex]]
    return tuple(".".join(path.with_suffix("").parts) for path in paths if path.parts[0] in ROOMS)


def is_of_annex(path: Path) -> bool:
    """Return whether a file belongs to any annex."""
    places = [Path(name) for names in ANNEXES.values() for name in names]
    return any(path == place or place in path.parents for place in places)


@pytest.mark.parametrize("annex", ANNEXES)
def test_annex_no_core_module_imports_it(annex: str):
    """The product without any annex imports nothing of this annex, not even for type checkers."""
    modules = modules_of(annex)
    assert [
        f"{path}: {name}"
        for path, names in imports_below(*ROOMS).items()
        if not is_of_annex(path)
        for name in sorted(names)
        if any(name == module or name.startswith(f"{module}.") for module in modules)
    ] == []


@pytest.mark.parametrize("annex", ANNEXES)
def test_annex_core_tests_do_not_import_it(annex: str):
    modules = modules_of(annex)
    assert [
        f"{path}: {name}"
        for path, names in imports_below("tests").items()
        if path not in _OF_DOCS and not is_of_annex(path)
        for name in sorted(names)
        if any(name == module or name.startswith(f"{module}.") for module in modules)
    ] == []


@pytest.mark.parametrize("annex", ANNEXES)
def test_annex_readme_is_short_and_names_its_removal(annex: str):
    text = (ROOT / ANNEXES[annex][0] / "README.md").read_text(encoding="utf-8")
    assert text.startswith("# Annex: ")
    assert 10 <= len(text.splitlines()) <= 25
    for word in ("**For whom**", "**Limits**", "**Remove it**", f'"annex {annex}"'):
        assert word in text
