"""Fixtures for the tests of the report: the record factory, and a headless Chromium where the machine has one."""

import importlib.util
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from models.results.stored import to_json

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def _load(name: str):
    """A helper module of this folder; test folders are no packages, so it is loaded by its path."""
    full = f"touchstone_tests_reports_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, Path(__file__).parent / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[full] = module
        spec.loader.exec_module(module)
    return sys.modules[full]


@pytest.fixture(scope="session")
def factory():
    return _load("record_factory")


@pytest.fixture(scope="session")
def chromium(tmp_path_factory: pytest.TempPathFactory):
    """An open browser; without one the tests are skipped, except in CI, where that is a failure."""
    executable = os.environ.get("TOUCHSTONE_CHROMIUM") or next(
        (found for name in _NAMES if (found := shutil.which(name))), None
    )
    if executable is None:
        sentence = f"no Chromium on this machine (looked for {', '.join(_NAMES)}); install one or set TOUCHSTONE_CHROMIUM to its path."
        if os.environ.get("CI") == "true":
            pytest.fail(sentence)
        pytest.skip(sentence)
    with _load("browser").Browser(executable, tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="session")
def full_folder(factory, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All eight pipelines, a crash, a time limit, a refusal, a cut record, and a cell without one."""
    odd = _load("odd_records")
    records = [
        *factory.runs(),
        odd.crashed(factory),
        odd.out_of_time(factory),
        odd.refused(factory),
    ]
    keys = (*(record.key for record in records), "gone-1")
    campaign = factory.campaign(records, keys=keys, quick=True, left_out=("the long pipelines",))
    folder = factory.store(tmp_path_factory.mktemp("full") / "all", records, campaign)
    (folder / "runs" / "cut-1").mkdir()
    (folder / "runs" / "cut-1" / "record.json").write_text(to_json(records[0])[:3000])
    return folder


@pytest.fixture(scope="session")
def hostile_folder(factory, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One good run beside one whose every string is markup that would run if it were not escaped."""
    records = [factory.runs()[0], _load("odd_records").hostile(factory)]
    campaign = factory.campaign(
        records,
        title=factory.HOSTILE,
        command=factory.HOSTILE,
        left_out=(factory.HOSTILE,),
        quick=True,
    )
    campaign = replace(campaign, keys=(*campaign.keys, factory.HOSTILE))
    folder = factory.store(tmp_path_factory.mktemp("hostile") / "all", records, campaign)
    return folder


@pytest.fixture(scope="session")
def page_file(full_folder: Path) -> Path:
    """All of its report in one file."""
    from reports.render import write_single

    return write_single(full_folder)


@pytest.fixture(scope="session")
def run_file(full_folder: Path) -> Path:
    """The page of one run of it."""
    from reports.render import PAGES, write_report

    write_report(full_folder)
    return full_folder / PAGES / "three_cart--strict.html"
