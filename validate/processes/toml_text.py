"""Read and write TOML; invalid files raise one sentence."""

from __future__ import annotations

import json
import reprlib
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from models.errors import TouchstoneError

# Larger than any campaign or map.
MOST_BYTES = 1_000_000


class TomlError(TouchstoneError):
    """The file is not TOML; the sentence does not name the file."""


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the text and its content. Raises TomlError."""
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
        text = data.decode("utf-8-sig")  # with or without a byte order mark
    except UnicodeDecodeError as error:
        raise TomlError("it is no text in UTF-8, and so no TOML") from error
    except (OSError, ValueError) as error:
        raise TomlError(
            f"it cannot be read ({getattr(error, 'strerror', None) or error})"
        ) from error
    if len(data) > MOST_BYTES:
        raise TomlError(
            f"it is larger than {MOST_BYTES // 1_000_000} MB, so it is not a file for this"
        )
    try:
        return text, tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TomlError(f"it is not TOML ({error})") from error
    except RecursionError as error:
        raise TomlError("its brackets are nested too deeply to be read") from error
    except ValueError as error:  # an integer of thousands of digits
        raise TomlError(f"it is not TOML that can be read ({error})") from error


# Expected values by type of pydantic error, for campaign files and maps.
_WANTED = {
    "string_type": "text", "bool_type": "true or false", "int_type": "a whole number",
    "float_type": "a number", "finite_number": "a finite number",
    "list_type": "a list", "dict_type": "a table", "model_type": "a table",
    "literal_error": "{expected}", "value_error": "{error}",
    "string_too_short": "a name",
    "string_pattern_mismatch": "a letter, and behind it at most 60 letters, digits and _",
    "too_short": "a list of {min_length} or more", "too_long": "a list of {max_length} or fewer",
    "greater_than": "above {gt:g}", "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le}",
}  # fmt: skip


def mistake(problem: Mapping[str, Any]) -> str:
    """Return one of pydantic's errors in our words.

    A ValueError of our validators has the expected value, a PydanticCustomError the whole text.
    """
    if problem["type"] == "missing":
        return "it is missing"
    if problem["type"] in _WANTED:
        wanted = _WANTED[problem["type"]].format(**problem.get("ctx", {}))
        return f"it is {reprlib.repr(problem['input'])}, but must be {wanted}"
    return problem["msg"]


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number and no bool; TOML integers have no limit."""
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )


def toml_value(value: Any) -> str:
    """Return a value on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return (
            "{ "
            + ", ".join(
                f"{toml_text(str(key))} = {toml_value(item)}" for key, item in value.items()
            )
            + " }"
            if value
            else "{}"
        )
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return toml_text(str(value))


def toml_text(text: str) -> str:
    """Return a basic string: JSON's escapes, and the delete character's."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
