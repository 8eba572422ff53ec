"""What pip installs: the wheel holds every file that is needed, and its command works outside a checkout, beside whatever the folder holds."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PARTS = (
    "models",
    "formulations",
    "validate",
    "reports",
    "touchstone.py",
    "touchstone_command.py",
    "touchstone_annexes.py",
)


def pip(*words: str) -> None:
    subprocess.run(
        [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words],
        check=True,
        capture_output=True,
    )


def tracked(*paths: str) -> list[str]:
    return subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", *paths], check=True, capture_output=True, text=True
    ).stdout.splitlines()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-deps", "--no-build-isolation", "-w", str(folder), str(ROOT))
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def site(wheel: Path) -> Path:
    """The folder that it is installed into."""
    folder = wheel.parent / "site"
    pip("install", "--no-deps", "--target", str(folder), str(wheel))
    return folder


def called(
    site: Path, folder: Path, *command: str, before: str = ""
) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": f"{before}{site}"}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_the_wheel_holds_our_files_and_no_others(wheel: Path):
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert inside == {name for name in tracked(*PARTS) if (ROOT / name).exists()}


@pytest.mark.slow
def test_its_command_works_in_a_folder_with_packages_of_the_same_names(site: Path, tmp_path: Path):
    for name in ("models", "formulations", "validate", "reports"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError\n")
    listed = called(site, tmp_path, sys.executable, str(site / "bin" / "touchstone"), "list")
    assert (listed.returncode, listed.stderr) == (0, "")
    assert "three_cart" in listed.stdout
    wrong = called(site, tmp_path, sys.executable, str(site / "bin" / "touchstone"), "lsit")
    assert (wrong.returncode, wrong.stderr) == (
        2,
        "error: there is no command 'lsit'; did you mean list?\n",
    )


@pytest.mark.slow
@pytest.mark.parametrize("command", ["touchstone", "touchstone-mpec"])
@pytest.mark.parametrize("name", ["models", "validate"])
def test_a_command_says_what_clashes(site: Path, tmp_path: Path, name: str, command: str):
    """PYTHONPATH comes before what is installed."""
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("raise RuntimeError\n")
    found = called(
        site,
        tmp_path,
        sys.executable,
        str(site / "bin" / command),
        "list",
        before=f"{tmp_path}{os.pathsep}",
    )
    assert (found.returncode, found.stdout) == (2, "")
    (sentence,) = found.stderr.splitlines()
    for part in (
        f"own package {name!r} in {site}",
        str(tmp_path / name),
        "rename yours",
        "PYTHONPATH",
    ):
        assert part in sentence


@pytest.mark.slow
def test_the_installed_face_is_the_wheel_s_own(site: Path, tmp_path: Path):
    found = called(
        site,
        tmp_path,
        sys.executable,
        "-c",
        "import touchstone; print(touchstone.__file__, 'three_cart' in touchstone.scenes())",
    )
    assert found.stdout.split() == [str(site / "touchstone.py"), "True"]


def test_no_sentence_sends_to_an_index_that_has_no_such_package():
    """The project is on no index: advice names its parts by `.[extra]`, or the packages themselves."""
    wrong = re.compile(r"touchstone-contact\[")
    assert wrong.search("pip install 'touchstone-contact[dask]'")
    found = [
        name
        for name in tracked("*.py", "*.md")
        if name != "tests/test_wheel.py"
        and (ROOT / name).exists()
        and wrong.search((ROOT / name).read_text(encoding="utf-8"))
    ]
    assert found == []
