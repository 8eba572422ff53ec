"""A disk that refuses a command: at each request that the command makes, one after the other.

It does what it was asked, or ends with one sentence;

what was there before is whole.
"""

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from killed_campaigns import FAKES_FOLDER, finished, unfinished

from models.catalog import load_scene
from models.codegen.compiler import find_compiler

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD is for Linux"),
]
_FOR_EVER = 2**62
_FAKES = (
    "--plugin",
    "refused_commands:PLUGIN",
    "--scene",
    "three_cart",
    "-k",
    "only_good or only_infeasible",
    "-j",
    "1",
)
_ERRORS = (errno.ENOSPC, errno.EROFS, errno.EIO)
_ERRORS_ELSEWHERE = (errno.EACCES, errno.ENOSPC, errno.EROFS)
# What follows --out, or stands beside it: {out} is the folder whose disk refuses.
_COMMANDS = {
    "a campaign": ("all", *_FAKES, "--out", "{out}"), "a report": ("report", "{out}"),
    "a single file": ("report", "{out}", "--single-file"),
    "an FMU": ("fmu", "three_cart", "-o", "{out}/three_cart.fmu"),
}  # fmt: skip
_SCENE = "bouncing_mass"
# Every fourth request: in the store each one is refused by test_store_faults.py.
_EACH = {"a campaign": 4, "a report": 4}
# The same for what lies elsewhere, and for answers that cost more to write: (words, what is in the
# environment, which requests are refused). {made} has what the command is given. Of files that are
# unpacked, all are written alike.
_ELSEWHERE = {
    "the cache": (
        ("fmu", _SCENE, "-o", "{made}/new.fmu"),
        {"TOUCHSTONE_CACHE": "{out}", "CC": "{made}/cc"},
        3,
    ),
    "checking an FMU": (
        ("check", "{made}/a.fmu", "--only", "set state restores"),
        {"TMPDIR": "{out}"},
        29,
    ),
    "replaying": (("replay", "{made}/plan.csv", "--scene", _SCENE), {"TMPDIR": "{out}"}, 13),
    "a replay": (("replay", "{made}/plan.csv", "--scene", _SCENE, "--out", "{out}/answer"), {}, 4),
    "parts of a scene": (("fmu", _SCENE, "--coupled", "-o", "{out}/answer.ssp"), {}, 1),
    "a campaign of a file": (
        ("run", "{made}/campaign.toml", "--plugin", _FAKES[1], "-j", "1", "--out", "{out}"),
        {},
        13,
    ),
}
# A compiler that takes no time: what it would have made is nowhere loaded.
_COMPILER = """#!/bin/sh
if [ "$1" = --version ]; then echo "one that takes no time"; exit; fi
while [ $# -gt 1 ]; do if [ "$1" = -o ]; then echo library > "$2"; fi; shift; done
"""
Ask = Callable[..., tuple[int, str, int]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Where a campaign will be that nothing was refused."""
    return tmp_path_factory.mktemp("whole")


@pytest.fixture(scope="module")
def ask(cli_environment, whole, tmp_path_factory):
    """ask(words, out, number, error) runs a command with that request refused: its exit code, what it said, how many requests there were.
    **environment: of that command alone.
    """
    folder = tmp_path_factory.mktemp("refusing")
    library, told = folder / "refusing_disk.so", folder / "told.txt"
    subprocess.run(
        [
            *find_compiler().command,
            "-O1",
            "-shared",
            "-fPIC",
            "-o",
            str(library),
            str(FAKES_FOLDER / "refusing_disk.c"),
            "-ldl",
        ],
        check=True,
    )
    environment = {**cli_environment, "LD_PRELOAD": str(library), "CELLS": str(whole / "runs")}
    command = [sys.executable, "-m", "refused_commands"]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=FAKES_FOLDER.parents[2],
    ) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        answers = server.stdout

        def asked(
            words: tuple[str, ...], out: Path, number: int, error: int, **environment: str
        ) -> tuple[int, str, int]:
            request = {
                "words": [word.format(out=out) for word in words], "below": str(out),
                "first": number, "last": number, "environment": environment,
            }  # fmt: skip
            print(
                json.dumps({**request, "error": error, "told": str(told)}),
                file=server.stdin,
                flush=True,
            )
            code, requests = json.loads(answers.readline())
            return code, told.read_text(), requests

        yield asked
        server.stdin.close()


@pytest.fixture(scope="module")
def stored(ask: Ask, whole: Path) -> Path:
    """The folder of a campaign of two cells."""
    code, told, _ = ask(_COMMANDS["a campaign"], whole, _FOR_EVER, 0)
    assert code == 0, told
    return whole


@pytest.mark.slow
@pytest.mark.parametrize("name", _COMMANDS)
def test_each_request_of_a_command_is_refused_in_turn(
    ask: Ask, stored: Path, tmp_path: Path, name: str
):
    old, out = tmp_path / "old", tmp_path / "out"
    shutil.copytree(stored, old)
    (old / "three_cart.fmu").write_text("an earlier one")
    if name == "a campaign":
        shutil.rmtree(old / "runs" / min(finished(old)))
    (old / "report.html").unlink()
    shutil.rmtree(old / "pages")
    (old / "results.csv").write_text("an earlier one")
    records = finished(old)

    def tried(number: int, error: int) -> tuple[int, str, int]:
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(old, out)
        return ask(_COMMANDS[name], out, number, error)

    code, told, requests = tried(_FOR_EVER, 0)
    assert code == 0, told
    assert requests >= 3
    new = {path: (out / path).read_bytes() for path in ("results.csv", "three_cart.fmu")}
    outcomes = set()
    for number in range(1, requests + 1, _EACH.get(name, 1)):
        error = _ERRORS[number % len(_ERRORS)]
        code, told, _ = tried(number, error)
        outcomes.add(code)
        sentences = [line for line in told.splitlines() if line.startswith("error:")]
        assert "Traceback" not in told
        assert "this should not have happened" not in told
        if code:
            assert (code, len(sentences)) == (3, 1), told
            assert (
                os.strerror(error).lower() in sentences[0].lower()
                or "the disk is full" in sentences[0]
            )
        assert records.items() <= finished(out).items()
        assert [path for path in unfinished(out) if ".partial" in path] == []
        for path, content in new.items():
            found = (out / path).read_bytes()
            if code:  # the old one, or the new one, of which a table has what is stored by then
                assert found == (old / path).read_bytes() or set(found.splitlines()) <= set(
                    content.splitlines()
                ), path
            else:
                assert found == content, path
        for page in out.rglob("*.html"):
            assert page.read_text().rstrip().endswith("</html>")
    assert 3 in outcomes, "nothing was refused"


@pytest.fixture(scope="module")
def made(tmp_path_factory, cli, cli_environment) -> Path:
    """An FMU, a plan that falls freely, a campaign file, and a cache that has all but FMUs."""
    folder = tmp_path_factory.mktemp("made")
    done = cli("fmu", _SCENE, "-o", str(folder / "a.fmu"))
    assert done.returncode == 0, done
    task = load_scene(_SCENE).task
    times = [k * task.step for k in range(41)]
    rows = [f"{t:.17g},{task.start[0] + task.start[1] * t - 4.905 * t**2:.17g}" for t in times]
    (folder / "plan.csv").write_text("\n".join(["t,q", *rows]) + "\n")
    (folder / "cc").write_text(_COMPILER)
    (folder / "cc").chmod(0o755)
    (folder / "campaign.toml").write_text('scenes = ["three_cart"]\npipelines = ["only_good"]\n')
    shutil.copytree(
        cli_environment["TOUCHSTONE_CACHE"],
        folder / "without",
        ignore=shutil.ignore_patterns("*.fmu", "building-*"),
    )
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", _ELSEWHERE)
def test_each_request_elsewhere_is_refused_in_turn(
    ask: Ask, stored: Path, made: Path, tmp_path: Path, name: str
):
    words, environment, each = _ELSEWHERE[name]
    out, answers = tmp_path / "out", ("new.fmu", "answer/score.json", "answer.ssp")

    def tried(number: int, error: int) -> tuple[int, str, int]:
        shutil.rmtree(out, ignore_errors=True)
        if "TOUCHSTONE_CACHE" in environment:
            shutil.copytree(made / "without", out)
        else:
            out.mkdir()
        given = {key: value.format(out=out, made=made) for key, value in environment.items()}
        return ask(
            tuple(word.replace("{made}", str(made)) for word in words), out, number, error, **given
        )

    whole, told, requests = tried(_FOR_EVER, 0)
    assert whole in (0, 1), told
    assert requests >= 3
    assert "TMPDIR" not in environment or list(out.iterdir()) == []
    codes = set()
    # What comes later is written as by `all`, or is unpacked like what came before.
    for number, error in zip(
        range(1, requests + 1, each), (*_ERRORS_ELSEWHERE, errno.ENOSPC), strict=False
    ):
        code, told, _ = tried(number, error)
        codes.add(code)
        sentences = [line for line in told.splitlines() if line.startswith("error:")]
        assert "Traceback" not in told
        assert "this should not have happened" not in told
        if code != whole:
            assert (code, len(sentences)) == (3, 1), (number, told)
            assert (
                os.strerror(error).lower() in sentences[0].lower()
                or "the disk is full" in sentences[0]
            ), sentences
            for path in (out / answer for answer in answers if (out / answer).exists()):
                assert path.stat().st_size > 500, "an answer is whole, or not there"
        assert [
            path.name
            for path in out.rglob("*")
            if path.name.startswith((".partial", "building-")) or path.suffix == ".tmp"
        ] == []
        assert "TMPDIR" not in environment or list(out.iterdir()) == []
    assert 3 in codes, "nothing was refused"
