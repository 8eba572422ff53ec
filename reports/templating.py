"""Templates of this room, with what they may use.

templates = Templates();  templates.render("run.html", view=view, anchor="run")
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from reports import wording
from reports.pages import tolerance

_FILTERS = (
    *("number", "cost", "error", "seconds", "percent", "plain", "spaced", "clean", "verdict", "answer"),
    *("count", "small", "product", "unit", "capital", "exact", "prose", "ratio"),
)


class Templates:
    """Each template is compiled once, whatever page it is rendered for."""

    def __init__(self, *folders: Path) -> None:
        """folders: of further templates, beside those of this room."""
        self._environment = Environment(
            loader=FileSystemLoader([Path(__file__).parent / "templates", *folders]),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            finalize=_finalized,
        )
        for name in _FILTERS:
            self._environment.filters[name] = getattr(wording, name)
        self._environment.globals["dash"] = wording.DASH
        self._environment.globals["windows"] = tolerance.windows_text

    def render(self, name: str, **values: Any) -> str:
        """The text of one template."""
        return self._environment.get_template(name).render(**values)


def _finalized(value: Any) -> Any:
    """Every string that reaches the page without being markup loses its control characters; escaping comes after."""
    return wording.clean(value) if isinstance(value, str) and not isinstance(value, Markup) else value
