"""The logger of FMI 2.0 formats a message with its arguments, for the instance that said it."""

import ctypes
import mmap
from typing import Any

import pytest

from models.codegen.compiler import compile_shared, find_compiler
from validate.fmi import logger

SAYS = """
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
void say(Logger log, void *environment, int kind)
{
    if (kind == 0) log(environment, "i", 3, "c", "file %s, line %d: %.3g %% of %zu", "a.txt", 7, 12.5, (unsigned long)9);
    if (kind == 1) log(environment, "i", 3, "c", "nine: %g %g %g %g %g %g %g %g %g", 1., 2., 3., 4., 5., 6., 7., 8., 9.);
    if (kind == 2) log(environment, "i", 3, "c", (const char *)0);
}

/* The same twice: by the logger, and by C. */
#define BOTH(...) log(environment, "i", 3, "c", __VA_ARGS__); snprintf(text, sizeof text, __VA_ARGS__); log(environment, "i", 3, "c", "%s", text)
void say_twice(Logger log, void *environment)
{
    char text[5000];
    static char long_text[6000];
    for (int k = 0; k < 5999; k++) long_text[k] = 'a' + k % 26;
    BOTH("%5d|%-5d|%05d|%+d|% d", 1, 2, 3, 4, 5);
    BOTH("%ld %lld %zu %td %jd %hd %hhd", -1L, 1LL << 40, (size_t)7, (ptrdiff_t)-7, (intmax_t)9, 300, 300);
    BOTH("%x %#X %o %u %c%c", 255, 255, 8, 4000000000u, 'o', 'k');
    BOTH("%f %.3e %12.4g| %-12.2f| %a %Lf", 0.5, 1e10, 3.14159, 2.0, 1.0, 0.25L);
    BOTH("%s, %10s|%-10s|%.2s|%*.*f|%-*d|", "all", "right", "left", "cut", 8, 2, 1.0, 4, 7);
    BOTH("%d%% of %s %.*s", 50, "it", 3, "abcdef");
    BOTH("%s", long_text + 1904);
    BOTH("no conversion at all");
}

/* Texts that are no formats, and no arguments. Registers hold what no pointer is. */
#define BARE(text) log(environment, "i", 3, "c", text, 1L, 1L, 1L, 1L)
void say_bare(Logger log, void *environment, const char *text) { BARE(text); }
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("says") / "say.so"
    flags = ("-O1", "-fPIC", "-shared")
    compile_shared(find_compiler(), {"say.c": SAYS}, path, flags=flags)
    return ctypes.CDLL(str(path))


@pytest.fixture
def say(library: Any) -> Any:
    return library.say


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


def test_conversions_are_those_of_c(library: Any):
    heard: list[bytes | None] = []
    callback, environment, kept = logger.made(heard.append)
    library.say_twice(callback, ctypes.c_void_p(environment))
    assert heard[0::2] == heard[1::2], kept
    assert len(heard) == 16


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tank is 5% short", "tank is 5%short"),
        ("%s and %10s", None),
        ("written: %n, %hhn", None),
        ("80 % of the range, 100 % sure, 20 % done", None),
        ("a stray % sign, one at the end %", None),
        ("odd %! %& %5.5.5q %", None),
        ("%ls %S %lc", None),
    ],
)
def test_text_that_is_no_format_arrives(text: str, words: str | None, library: Any):
    """The strings' addresses are 1, which nobody may read; %n would write to one."""
    heard: list[bytes | None] = []
    callback, environment, kept = logger.made(heard.append)
    library.say_bare(callback, ctypes.c_void_p(environment), text.encode())
    assert len(heard) == 1, kept
    if words is None:
        assert heard[0] == text.encode()
    else:
        assert (heard[0] or b"").startswith(b"tank is 5")


def test_string_at_the_end_of_readable_memory_is_cut_there(library: Any):
    page = mmap.PAGESIZE
    memory = mmap.mmap(-1, 2 * page)
    start = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    memory[page - 4 : page] = b"edge"
    libc = ctypes.CDLL(None)
    assert libc.mprotect(ctypes.c_void_p(start + page), page, 0) == 0
    heard: list[bytes | None] = []
    callback, environment, kept = logger.made(heard.append)
    log = ctypes.CFUNCTYPE(
        None,
        ctypes.c_void_p,
        ctypes.c_char_p,
        ctypes.c_int,
        ctypes.c_char_p,
        ctypes.c_char_p,
        ctypes.c_void_p,
    )
    log(ctypes.cast(callback, ctypes.c_void_p).value)(
        environment, b"i", 3, b"c", b"%s!", start + page - 4
    )
    assert heard == [b"edge!"], kept
