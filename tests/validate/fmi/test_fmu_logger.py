"""The logger of FMI 2.0 formats a message with its arguments, for the instance that said it."""

import ctypes
from typing import Any

import pytest

from models.codegen.compiler import compile_shared, find_compiler
from validate.fmi import logger

SAYS = """
typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
void say(Logger log, void *environment, int kind)
{
    if (kind == 0) log(environment, "i", 3, "c", "file %s, line %d: %.3g %% of %zu", "a.txt", 7, 12.5, (unsigned long)9);
    if (kind == 1) log(environment, "i", 3, "c", "nine: %g %g %g %g %g %g %g %g %g", 1., 2., 3., 4., 5., 6., 7., 8., 9.);
    if (kind == 2) log(environment, "i", 3, "c", (const char *)0);
}
"""


@pytest.fixture(scope="module")
def say(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("says") / "say.so"
    flags = ("-O1", "-fPIC", "-shared")
    compile_shared(find_compiler(), {"say.c": SAYS}, path, flags=flags)
    return ctypes.CDLL(str(path)).say


def test_messages_hold_their_arguments_and_reach_their_instance(say: Any):
    heard: dict[str, list[bytes | None]] = {"first": [], "second": []}
    made = {name: logger.made(texts.append) for name, texts in heard.items()}
    for name, kind in (("first", 0), ("second", 1), ("first", 2)):
        callback, environment, _ = made[name]
        say(callback, ctypes.c_void_p(environment), kind)
    assert heard == {
        "first": [b"file a.txt, line 7: 12.5 % of 9", b""],
        "second": [b"nine: 1 2 3 4 5 6 7 8 9"],
    }


def test_an_environment_that_is_none_reaches_the_newest_instance(say: Any):
    heard: list[bytes | None] = []
    callback, _, kept = logger.made(heard.append)
    for wrong in (None, 12345):
        say(callback, ctypes.c_void_p(wrong), 0)
    assert len(heard) == 2, kept


def test_without_a_compiler_a_message_comes_as_it_is(monkeypatch: pytest.MonkeyPatch, say: Any):
    monkeypatch.setattr(logger, "_library", lambda: None)
    heard: list[bytes | None] = []
    callback, environment, _ = logger.made(heard.append)
    say(callback, ctypes.c_void_p(environment), 1)
    assert heard == [b"nine: %g %g %g %g %g %g %g %g %g"]
