"""Seeded mutations that turn a good file into a hostile one: of text, of bytes, of nested data, of data as JSON."""

import copy
import json
import random
from typing import Any

_TOKENS = [
    "\0", "nan", "-inf", "1e999", "9" * 5000, "[" * 3000, "{" * 3000, "\ufeff", "\u2028", "\r", '"',
    '"""', "'", "=", ",", ";", "\t", "#", "-0",
    "1_000", "true", "..", "../../etc/passwd", "\x1b[31m", "x" * 100_000,
    "<!DOCTYPE a [<!ENTITY b 'c'>]>", "&lt;", "]]>", "0x10", "é", "1979-13-01",
]  # fmt: skip
_VALUES: list[Any] = [
    None, True, -1, 0, 10**30, 1.5, 1e308, -1e308, "", "x" * 10_000, "\0", "nan", [], {},
    [[[[[]]]]], {"a": {"b": 1}}, ["x", 1], "../../x.py", "é\u202e",
]  # fmt: skip


def spoilt_text(rng: random.Random, text: str) -> bytes:
    """One to four mutations of a text, now and then of its bytes."""
    data = text
    for _ in range(rng.randint(1, 4)):
        a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
        b = min(b, a + 40)
        kind = rng.randrange(6)
        if kind == 0:
            data = data[:a] + data[b:]
        elif kind == 1:
            data = data[:a] + rng.choice(_TOKENS) + data[b:]
        elif kind == 2:
            data = data[:a] + data[a:b] * rng.randint(2, 50) + data[b:]
        elif kind == 3:
            data = data[:a]
        elif kind == 4:
            lines = data.splitlines(keepends=True)
            rng.shuffle(lines)
            data = "".join(lines)
        else:
            data = data[:a] + chr(rng.randrange(1, 0xD7FF)) + data[a:]
    return spoilt_bytes(rng, data.encode("utf-8")) if rng.random() < 0.2 else data.encode("utf-8")


def spoilt_bytes(rng: random.Random, data: bytes) -> bytes:
    spoilt = bytearray(data)
    for _ in range(rng.randint(1, 30)):
        if spoilt:
            spoilt[rng.randrange(len(spoilt))] = rng.randrange(256)
    return bytes(spoilt[: rng.randrange(len(spoilt) + 1)]) if rng.random() < 0.2 else bytes(spoilt)


def spoilt_data(rng: random.Random, data: Any) -> Any:
    """A copy of nested data with one to three values or keys replaced."""
    data = copy.deepcopy(data)
    for _ in range(rng.randint(1, 3)):
        node = data
        while isinstance(node, (dict, list)) and node:
            key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
            if not isinstance(node[key], (dict, list)) or not node[key] or rng.random() < 0.25:
                if isinstance(node, dict) and rng.random() < 0.3:
                    node[rng.choice(["typo", "", "k\0", "é" * 200])] = node.pop(key)
                else:
                    node[key] = copy.deepcopy(rng.choice(_VALUES))
                break
            node = node[key]
    return data


def spoilt_json(rng: random.Random, data: Any) -> bytes:
    return (
        spoilt_text(rng, json.dumps(data))
        if rng.random() < 0.5
        else json.dumps(spoilt_data(rng, data)).encode()
    )
