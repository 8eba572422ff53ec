"""Random small MPECs of many kinds, with the branches of every condition written down beside it.

    drawn_mpec()  # a hypothesis strategy: numbers of two decimals; a wrong answer is shrunk
    random_mpec(seed)  # the same construction from numpy's generator, with data of all digits

At most 4 pairs (6 conditions) and 3 further variables, in blocks, with mutable parameters, either
sense, in every form of `complements`, some conditions twice. A kind is what makes a problem hard;
seed % len(KINDS) is its index.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyomo.environ as pyo
from hypothesis import strategies as st
from pyomo.mpec import Complementarity, ComplementarityList, complements

KINDS = (
    "convex", "linear", "unbounded", "infeasible", "degenerate", "scaled", "nonconvex", "equality",
    "fixed", "functions", "box", "curved", "biactive",
)  # fmt: skip
# One relation: lower <= body <= upper.
Relation = tuple[Any, float, float]
_INF = math.inf
_FAR = 5.0  # bounds of variables, in units of their scale


@dataclass(kw_only=True, repr=False)
class RandomMpec:
    """branches: of each condition its alternatives, each a list of relations that hold together. is_convex: every branch is a convex program."""

    seed: int
    kind: str
    model: Any
    random: Any
    x: list[Any] = field(default_factory=list)
    y: list[Any] = field(default_factory=list)
    scale: np.ndarray = field(default_factory=lambda: np.ones(0))
    conditions: list[Any] = field(default_factory=list)
    branches: list[list[list[Relation]]] = field(default_factory=list)
    is_convex: bool = True

    @property
    def scaled(self) -> list[Any]:
        """All variables, each about 1."""
        return [x / float(s) for x, s in zip(self.x, self.scale, strict=True)] + self.y

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def linear(self) -> Any:
        """A random linear expression; of half integers where ties are wanted."""
        weights = self.random.normal(size=len(self.x) + len(self.y))
        if self.kind in ("degenerate", "biactive") or self.chance(0.2):
            weights = np.round(2 * weights) / 2
        return sum(float(w) * z for w, z in zip(weights, self.scaled, strict=True))

    def pick(self, makers: list[Callable[[], Any]]) -> Any:
        return makers[int(self.random.integers(0, len(makers)))]()


class _Drawn:
    """The methods of numpy's generator that are used here, drawn by hypothesis.

    Each shrinks towards 0, and chances towards no.
    """

    def __init__(self, draw: Callable[[Any], int]) -> None:
        self._draw = draw

    def integers(self, low: int, high: int) -> int:
        return self._draw(st.integers(low, high - 1))

    def random(self) -> float:
        return 1.0 - self._draw(st.integers(1, 100)) / 100

    def uniform(self, low: float = 0.0, high: float = 1.0, size: int | None = None) -> Any:
        return self._numbers(0, 100, size) * (high - low) + low

    def normal(self, size: int | None = None) -> Any:
        return self._numbers(-250, 250, size)

    def _numbers(self, low: int, high: int, size: int | None) -> Any:
        drawn = [self._draw(st.integers(low, high)) / 100 for _ in range(size or 1)]
        return np.float64(drawn[0]) if size is None else np.array(drawn)


@st.composite
def drawn_mpec(draw: Any) -> RandomMpec:
    kind = draw(st.sampled_from(KINDS))
    return _built(RandomMpec(seed=0, kind=kind, model=pyo.ConcreteModel(), random=_Drawn(draw)))


def random_mpec(seed: int) -> RandomMpec:
    return _built(
        RandomMpec(
            seed=seed,
            kind=KINDS[seed % len(KINDS)],
            model=pyo.ConcreteModel(),
            random=np.random.default_rng(seed),
        )
    )


def _built(p: RandomMpec) -> RandomMpec:
    _variables(p)
    _objective(p)
    for k in range(len(p.y)):
        _condition(p, k, _second_side(p, k))
    if p.chance(0.2):  # the same twice
        p.conditions.append(p.conditions[0])
        p.branches.append(p.branches[0])
    if len(p.y) > 1 and p.chance(0.15):  # a pair of two that have a pair already
        _pair(p, complements(p.y[0] >= 0, p.y[1] >= 0), p.y[0], p.y[1])
    _declare(p)
    _rows(p)
    if p.kind == "fixed":
        for variable in (*p.x, *p.y):
            if p.chance(0.3):
                variable.fix(float(np.round(abs(p.random.normal()), 1)) if p.chance(0.6) else 0.0)
    if p.chance(0.2):
        p.model.off = pyo.Block()
        p.model.off.pair = Complementarity(
            expr=complements(p.x[0] >= 100 * float(p.scale[0]), p.y[0] >= 100)
        )
        p.model.off.deactivate()
    return p


def _variables(p: RandomMpec) -> None:
    count, pairs = int(p.random.integers(1, 4)), int(p.random.integers(1, 5))
    p.scale = 10.0 ** p.random.uniform(-6, 6, count) if p.kind == "scaled" else np.ones(count)
    start = p.random.normal(size=count) * p.scale
    p.model.x = pyo.Var(range(count), initialize=dict(enumerate(start.tolist())))
    p.x = list(p.model.x.values())
    if p.kind != "unbounded":
        for variable, scale in zip(p.x, p.scale.tolist(), strict=True):
            variable.setlb(-_FAR * scale)
            variable.setub(_FAR * scale)
    p.model.param = pyo.Param(
        range(3),
        mutable=True,
        initialize=dict(enumerate(np.round(p.random.normal(size=3), 1).tolist())),
    )
    p.model.b = pyo.Block(range(2))
    p.model.b[0].y = pyo.Var(
        range(pairs), initialize=dict(enumerate(np.abs(p.random.normal(size=pairs)).tolist()))
    )
    p.y = list(p.model.b[0].y.values())
    if p.kind == "infeasible" or p.chance(0.5):
        for variable in p.y:
            variable.setlb(0)


def _objective(p: RandomMpec) -> None:
    z = p.scaled
    goal = 2 * p.random.normal(size=len(z))
    if p.kind in ("degenerate", "biactive"):
        goal = np.round(goal)
    cost: Any = sum((one - float(g)) ** 2 for one, g in zip(z, goal, strict=True))
    if p.kind in ("linear", "unbounded"):
        cost = p.linear() + (0.5 * z[0] ** 2 if p.kind == "unbounded" and p.chance(0.5) else 0.0)
    elif p.kind == "nonconvex":
        cost = (
            cost
            - float(p.random.uniform(0.4, 3)) * z[0] ** 2
            - float(p.random.uniform()) * z[0] * z[-1]
        )
    elif p.kind == "functions":
        first = z[0]
        cost = cost + p.pick([
            lambda: pyo.exp(0.3 * first), lambda: -pyo.log(first + 6.5),
            lambda: pyo.sqrt(first + 7), lambda: pyo.sin(first), lambda: first**4 / 10,
            lambda: pyo.cos(first) * z[-1],
        ])  # fmt: skip
    elif p.kind == "scaled":
        cost = cost * 10.0 ** float(p.random.uniform(-4, 4))
    p.is_convex = p.kind not in (
        "nonconvex",
        "functions",
        "curved",
        "biactive",
        "infeasible",
        "scaled",
    )
    up = p.chance(0.25)
    p.model.cost = pyo.Objective(
        expr=-cost if up else cost, sense=pyo.maximize if up else pyo.minimize
    )


def _second_side(p: RandomMpec, k: int) -> Any:
    x, y, count = p.scaled[: len(p.x)], p.y, len(p.y)
    whole = float(p.random.integers(-1, 2))
    if p.kind == "biactive":
        return p.pick([lambda: 2.0 * y[k], lambda: x[k % len(x)] - whole, lambda: x[k % len(x)]])
    if p.kind == "degenerate":
        return p.pick([lambda: x[k % len(x)] + abs(whole), lambda: y[(k + 1) % count] + x[0]])
    if p.kind == "curved":
        return p.pick([
            lambda: x[0] ** 2 - 1 + y[k], lambda: pyo.exp(x[0]) - y[k] - 1,
            lambda: x[0] * y[k] - 0.5, lambda: pyo.sqrt(y[k] ** 2 + 1) - 1 + x[0],
            lambda: (x[0] - y[k]) ** 3,
        ])  # fmt: skip
    weights, couple = p.random.normal(size=count), p.random.normal(size=len(x))
    weights[k] = abs(weights[k]) + 0.1 * count
    shift = p.model.param[k % 3] if p.chance(0.5) else float(p.random.normal())
    side = (
        sum(float(w) * one for w, one in zip(weights, y, strict=True))
        + sum(float(c) * one for c, one in zip(couple, x, strict=True))
        + shift
    )
    return side * 10.0 ** float(p.random.uniform(-5, 5)) if p.kind == "scaled" else side


def _pair(p: RandomMpec, condition: Any, first: Any, second: Any) -> None:
    """0 <= first complementary to second >= 0, both as expressions."""
    p.conditions.append(condition)
    p.branches.append(
        [[(first, 0.0, 0.0), (second, 0.0, _INF)], [(first, 0.0, _INF), (second, 0.0, 0.0)]]
    )


def _condition(p: RandomMpec, k: int, side: Any) -> None:
    y, is_bounded = p.y[k], p.y[k].lb is not None
    low = 0.0 if is_bounded or p.chance(0.7) else float(np.round(p.random.normal(), 1))
    if p.kind == "box" or p.chance(0.1):
        low = 0.0 if is_bounded else -float(p.random.integers(0, 3))
        high = low + float(p.random.integers(1, 4))
        box = pyo.inequality(low, y, high)
        p.conditions.append(complements(box, side) if p.chance(0.5) else complements(side, box))
        p.branches.append(
            [
                [(y, low, low), (side, 0.0, _INF)],
                [(y, high, high), (side, -_INF, 0.0)],
                [(side, 0.0, 0.0), (y, low, high)],
            ]
        )
    elif p.kind == "equality" and p.chance(0.4):
        if p.chance(0.5):
            p.conditions.append(complements(side == low, y))
            p.branches.append([[(side, low, low)]])
        else:
            p.conditions.append(complements(y >= low, side == 0))
            p.branches.append([[(y, low, _INF), (side, 0.0, 0.0)]])
    else:
        make, second = p.pick([
            lambda: (complements(y >= low, side >= 0), side),
            lambda: (complements(side >= 0, y >= low), side),
            lambda: (complements(low <= y, -side <= 0), side),
            lambda: (complements(side <= 0, y >= low), -side),
        ])  # fmt: skip
        _pair(p, make, y - low, second)


def _declare(p: RandomMpec) -> None:
    """Indexed, as a list in a block, or one by one in two blocks."""
    m, conditions = p.model, p.conditions
    way = p.random.random()
    if way < 0.4:
        m.pair = Complementarity(range(len(conditions)), rule=lambda _, k: conditions[k])
    elif way < 0.7:
        m.b[1].pair = ComplementarityList(rule=iter(conditions))
    else:
        for k, condition in enumerate(conditions):
            m.b[k % 2].add_component(f"pair{k}", Complementarity(expr=condition))


def _rows(p: RandomMpec) -> None:
    rows = p.model.rows = pyo.ConstraintList()
    z, y = p.scaled, p.y
    for _ in range(int(p.random.integers(0, 3))):
        body, level, kind = p.linear(), float(np.round(2 * p.random.normal(), 1)), p.random.random()
        factor = 10.0 ** float(p.random.uniform(-5, 5)) if p.kind == "scaled" else 1.0
        low, high = (
            (-_INF, level + 2)
            if kind < 0.6
            else (level - 1, level + 2)
            if kind < 0.9 or p.kind == "scaled"
            else (level, level)
        )
        rows.add((None if low == -_INF else factor * low, factor * body, factor * high))
        if p.chance(0.3):  # redundant, twice
            rows.add(2 * body <= 2 * (level + 2))
            rows.add(body <= level + 2)
    if p.kind == "infeasible":
        p.pick([
            lambda: rows.add(sum(y) <= -0.1), lambda: rows.add(z[0] ** 2 + z[-1] ** 2 <= -0.01),
            lambda: (rows.add(y[0] * z[0] >= 1), rows.add(z[0] ** 2 <= 0.25), rows.add(y[0] <= 1)),
            lambda: (rows.add(y[0] >= 1), rows.add(y[-1] <= 0.5 * y[0] - 1)),
        ])  # fmt: skip
    elif p.kind in ("nonconvex", "curved") and p.chance(0.5):
        p.pick([
            lambda: rows.add(z[0] ** 2 + z[-1] ** 2 >= 1), lambda: rows.add(z[0] * z[-1] <= 0.5),
            lambda: rows.add(z[0] ** 2 + z[-1] ** 2 <= 4),
            lambda: rows.add(pyo.exp(z[-1]) <= 3 + z[0] ** 2),
        ])  # fmt: skip
    elif p.kind == "biactive" and p.chance(0.5):
        p.pick(
            [lambda: rows.add(z[0] ** 2 <= 0), lambda: rows.add(y[0] ** 2 + z[0] ** 2 <= 2 * y[0])]
        )
