"""Strict templates: an undefined name stops the build, numbers are written so that they read back bit for bit."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jinja2

_FOLDER = Path(__file__).parent / "templates"


def number(value: float) -> str:
    """The shortest text that reads back as the same double; C's HUGE_VAL for an infinite one."""
    if math.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


@lru_cache(maxsize=1)
def _engine() -> jinja2.Environment:
    import jinja2  # only where an FMU is built, not where it is found

    engine = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        undefined=jinja2.StrictUndefined,
        autoescape=lambda name: name is not None and name.endswith((".xml.j2", ".html.j2")),
        keep_trailing_newline=True,
    )
    engine.filters["number"] = number
    engine.filters["isfinite"] = math.isfinite
    return engine


def render(template: str, **context: Any) -> str:
    """The text of `templates/<template>`; raises jinja2.UndefinedError if the template names something not given."""
    return _engine().get_template(template).render(**context)
