"""Templates of this room, with what they may use.

templates = Templates();  templates.render("article.html", parcels, view=view)      parts that the template folds go to `parcels`
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from reports import wording
from reports.pages import tolerance
from reports.parcels import CLOSES, OPENS, Parcels, Token

_FILTERS = (
    *("number", "cost", "error", "seconds", "percent", "plain", "spaced", "clean", "verdict", "answer"),
    *("count", "small", "product", "unit", "capital", "exact", "prose"),
)


class Templates:
    """Each template is compiled once, whatever page it is rendered for."""

    def __init__(self, *folders: Path) -> None:
        """folders: of further templates, beside those of this room."""
        self._parcels = Parcels()
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
        self._environment.globals["fold"] = lambda block, caller: self._parcels.keep(block, caller())

    def compile(self, *names: str) -> None:
        """Compile templates before they are needed."""
        for name in names:
            self._environment.get_template(name)

    def render(self, name: str, parcels: Parcels, **values: Any) -> str:
        """The text of one template; no two renderings may run at once."""
        self._parcels = parcels
        return self._environment.get_template(name).render(**values)


def _finalized(value: Any) -> Any:
    """Every string that reaches the page without being markup loses its control characters; escaping comes after."""
    if isinstance(value, Token) or not isinstance(value, str):
        return value
    if not isinstance(value, Markup):
        return wording.clean(value)
    return Markup(value.replace(OPENS, "").replace(CLOSES, "")) if OPENS in value or CLOSES in value else value
