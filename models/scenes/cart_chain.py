"""n carts in a row, n = 2..20: the paper's scene at any size; the outer two are driven.

    cart_chain(3)  # three_cart, bit for bit, except for its name
    cart_chain(20)  # 40 states, 19 contacts, 2 inputs

With more than three carts the n - 1 gaps share 1 m, and each cart must move on by one gap (three
carts: 0.5 m, as in the paper). Inner carts need contact to move.
"""

from dataclasses import replace
from itertools import pairwise

import sympy as sp

from models.errors import SceneError
from models.scene import Coordinate, Scene, Shape, Task
from models.scenes.three_cart import SCENE as THREE_CART
from models.scenes.three_cart import c, d, m

SMALLEST = 2
LARGEST = 20
LENGTH = 0.5
FREE_SPACE = 1.0
FIRST = 2.0


def cart_chain(n: int, steps: int = 500) -> Scene:
    """Return the scene of n carts with `steps` steps of 0.01 s.

    Raise SceneError unless 2 <= n <= 20.
    """
    if isinstance(n, bool) or not isinstance(n, int) or not SMALLEST <= n <= LARGEST:
        raise SceneError(
            f"scene cart_chain: n is {n!r}, but must be a whole number of carts from {SMALLEST} to {LARGEST}."
        )
    q = sp.symbols(f"q1:{n + 1}", real=True)
    v = sp.symbols(f"v1:{n + 1}", real=True)
    first, last = sp.symbols(f"u1 u{n}", real=True)
    gap = FREE_SPACE / (n - 1)
    start = tuple(FIRST + index * (LENGTH + gap) for index in range(n))
    forces = [-c * speed for speed in v]
    forces[0] += first
    forces[-1] += last
    places = ["left", *(f"inner_{index}" for index in range(2, n)), "right"]
    return replace(
        THREE_CART,
        name="cart_chain",
        title=f"{n} carts in a row: the outer two push those between them",
        source="ours: section V of Suh and Wang (three_cart) with n carts; masses, damping, stiffness, length, bounds and limits are those there",
        coordinates=tuple(
            Coordinate(
                symbol=position, velocity=speed, unit="m", description=f"position of cart {index}"
            )
            for index, (position, speed) in enumerate(zip(q, v, strict=True), start=1)
        ),
        inputs=(THREE_CART.inputs[0], replace(THREE_CART.inputs[1], symbol=last)),
        kinetic_energy=m * sum(speed**2 for speed in v) / 2,
        forces=tuple(forces),
        contacts=tuple(
            replace(
                THREE_CART.contacts[0],
                name=contact,
                bodies=bodies,
                penetration=d - (right - left),
                description=f"cart {index} against cart {index + 1}",
            )
            for index, (contact, bodies, left, right) in enumerate(
                zip(_contact_names(n), pairwise(places), q[:-1], q[1:], strict=True), start=1
            )
        ),
        task=Task(
            start=(*start, *[0.0] * n),
            goal=(*(position + gap for position in start), *[0.0] * n),
            running_cost=first**2 + last**2,
            step=0.01,
            steps=steps,
        ),
        limits=tuple(
            replace(limit, reason=f"as for three carts of this kind on this grid: {limit.reason}")
            for limit in THREE_CART.limits
        ),
        answers=(),
        shapes=tuple(
            Shape(name=place, kind="box", x=position, y=d / 2, size=(d, d))
            for place, position in zip(places, q, strict=True)
        ),
    )


def _contact_names(n: int) -> list[str]:
    return (
        ["left", *(f"inner_{index}" for index in range(2, n - 1)), "right"] if n > 2 else ["pair"]
    )


SCENE = cart_chain(5, steps=250)
