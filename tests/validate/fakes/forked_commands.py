"""Commands of ours, each in a fork of a process that has imported what commands import: that takes longer than most of them.

with forked_commands(environment) as run:
    # as subprocess.run([sys.executable, "-m", "validate", "list"], ..) would
    done = run(["-m", "validate", "list"], environment)
"""

import gc
import importlib
import json
import os
import pkgutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

Run = Callable[[Sequence[str], Mapping[str, str]], subprocess.CompletedProcess[str]]


@contextmanager
def forked_commands(environment: Mapping[str, str]) -> Iterator[Run]:
    """run(words, environment) runs `python *words` in this working folder to its end, with nothing to read."""
    command = [sys.executable, "-m", "forked_commands"]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        ) as server,
    ):
        assert server.stdin is not None
        assert server.stdout is not None
        streams = [Path(folder) / name for name in ("out", "err")]

        def run(
            words: Sequence[str], environment: Mapping[str, str]
        ) -> subprocess.CompletedProcess[str]:
            asked = {
                "words": [*words],
                "environment": {**environment},
                "streams": [*map(str, streams)],
                "cwd": os.getcwd(),
            }
            server.stdin.write(json.dumps(asked) + "\n")
            server.stdin.flush()
            code = int(server.stdout.readline())
            out, err = (path.read_text(encoding="utf-8", errors="replace") for path in streams)
            return subprocess.CompletedProcess([*words], code, out, err)

        yield run


def _serve() -> str:
    """Fork for each command asked for; in the fork, return the module whose main it is to call."""
    for line in sys.stdin:
        if (child := os.fork()) == 0:
            return _become(**json.loads(line))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
    sys.exit()


def _become(
    words: Sequence[str], environment: Mapping[str, str], streams: Sequence[str], cwd: str
) -> str:
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd)
    nothing, (out, err) = (
        os.open(os.devnull, os.O_RDONLY),
        (os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC) for path in streams),
    )
    for standard, stream in enumerate((nothing, out, err)):
        os.dup2(stream, standard)
        os.close(stream)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - what is buffered of the other one are commands to come
    _, module, *arguments = words
    sys.argv = [str(Path(module) / "__main__.py"), *arguments]
    return module


def _import_commands() -> None:
    """What commands import, by and by."""
    for package in ("validate.cli", "reports"):
        for found in pkgutil.iter_modules(importlib.import_module(package).__path__, f"{package}."):
            if not found.name.endswith("__main__"):
                importlib.import_module(found.name)
    gc.freeze()


if __name__ == "__main__":
    _import_commands()
    module = _serve()
    importlib.import_module(f"{module}.__main__").main(f"{module}.cli.group")
