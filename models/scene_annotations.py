"""What a scene says beside its physics: limits of the score, known answers, how its bodies are drawn."""

from __future__ import annotations

from dataclasses import InitVar, dataclass

import sympy as sp

from models.errors import SceneError
from models.scene_values import as_expression, as_number, check_text, settle

# The shapes that are drawn, and how many lengths their size may have.
_SHAPES = {"box": (2,), "disc": (1,), "line": (1,), "wall": (1, 2)}


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The largest value of a metric of the score with which a plan still holds, and the reason for that number.

    value: in the metric's unit; None waives the limit that the metric has by default (validate.judge.score.table), which takes a reason too.
    """

    metric: str = ""
    value: float | None
    reason: str
    figure: InitVar[str | None] = None  # what `metric` was called up to version 0.1

    def __post_init__(self, figure: str | None) -> None:
        if figure is not None:
            raise SceneError(f"limit on {figure}: figure= is now called metric=; write Limit(metric={figure!r}, value=.., reason=..).")
        check_text("limit: metric", self.metric)
        check_text(f"limit on {self.metric}: reason", self.reason, empty=self.value is not None)
        if self.value is None:
            return
        settle(self, "value", as_number(f"limit on {self.metric}", self.value))
        if self.value < 0.0:
            raise SceneError(f"limit on {self.metric}: {self.value:g} is below 0, which no metric can be.")


def goal_limits(*, position: float | None = None, velocity: float | None = None, reason: str) -> tuple[Limit, ...]:
    """How near to the goal is near enough, the same for a plan and its replay; None where the goal asks for none.

    >>> [limit.metric for limit in goal_limits(position=0.02, reason="as much as the wall shall be pressed in")]
    ['terminal_position_error', 'replay_terminal_position_error']
    """
    return tuple(
        Limit(metric=f"{of}terminal_{part}_error", value=value, reason=reason)
        for part, value in (("position", position), ("velocity", velocity))
        if value is not None
        for of in ("", "replay_")
    )


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A known answer of the scene: what it is, its value, tolerance and source.

    measure: what to hold against it in the replay of the free motion, by a name that the score knows (validate.judge.score.equations); empty: nothing.
    """

    quantity: str
    value: float
    tolerance: float
    source: str
    measure: str = ""

    def __post_init__(self) -> None:
        check_text("answer: quantity", self.quantity)
        check_text(f"answer {self.quantity}: source", self.source, empty=True)
        for field in ("value", "tolerance"):
            settle(self, field, as_number(f"answer {self.quantity}: {field}", getattr(self, field)))
        if self.tolerance <= 0.0:
            raise SceneError(f"answer {self.quantity}: the tolerance is {self.tolerance:g}, but must be positive.")


@dataclass(frozen=True, kw_only=True)
class Shape:
    """How a body is drawn: `kind` "box", "disc", "line" or "wall"; `x`, `y` its centre and `angle`, as expressions in q [m, rad];
    `size`: (width, height), (radius,), or (length,) [m]."""

    name: str
    kind: str
    x: sp.Expr
    y: sp.Expr
    size: tuple[sp.Expr | float, ...]
    angle: sp.Expr = sp.S.Zero

    def __post_init__(self) -> None:
        check_text("shape: name", self.name)
        if not isinstance(self.kind, str) or self.kind not in _SHAPES:
            raise SceneError(f"shape {self.name}: the kind {self.kind!r} is none of {', '.join(_SHAPES)}.")
        for field in ("x", "y", "angle"):
            settle(self, field, as_expression(f"shape {self.name}: {field}", getattr(self, field)))
        if not isinstance(self.size, (tuple, list)) or len(self.size) not in _SHAPES[self.kind]:
            raise SceneError(
                f"shape {self.name}: the size of a {self.kind} is a tuple of {' or '.join(map(str, _SHAPES[self.kind]))} lengths, not {self.size!r}."
            )
        settle(self, "size", tuple(as_expression(f"shape {self.name}: size", value) for value in self.size))
