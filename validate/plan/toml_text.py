"""TOML in and out: hostile files end in one sentence, and what is written can be read again."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from models.errors import TouchstoneError

# No campaign or map that somebody wrote comes near this size.
MOST_BYTES = 1_000_000


class TomlError(TouchstoneError):
    """A file that is not TOML; the sentence does not name the file."""


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """The text and its content. Raises TomlError."""
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
        text = data.decode("utf-8-sig")  # with or without the mark that editors of Windows begin with
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise TomlError(f"it cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if len(data) > MOST_BYTES:
        raise TomlError(f"it is larger than {MOST_BYTES // 1_000_000} MB, so it is not a file for this")
    try:
        return text, tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TomlError(f"it is not TOML ({error})") from error
    except RecursionError as error:
        raise TomlError("its brackets are nested too deeply to be read") from error
    except ValueError as error:  # a whole number of thousands of digits
        raise TomlError(f"it is not TOML that can be read ({error})") from error


def toml_value(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{toml_text(str(key))} = {toml_value(item)}" for key, item in value.items()) + " }" if value else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return toml_text(str(value))


def toml_text(text: str) -> str:
    """A basic string: what JSON escapes - control characters, quotes and backslashes - and the delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
