"""Plans of a relaxed contact law, whose forces act from a distance, and what is left of them without the columns that show it."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.verdicts.plans import FORCES, GOAL, MOTION, NoPlanError, Plan, as_plan, found, motion_of, reaches, scene_of

RELAXED = {
    "three_cart": "softplus_dc+strict",
    "hopper": "softplus_dc+strict",
    "cart_chain": "softplus_dc+strict",
    "wall_pendulum": "softplus_dc+strict",
}


def relaxed(reference: str) -> dict[str, tuple[Callable[[], Plan], tuple[str, ...]]]:
    """A softplus plan, whose forces act from a distance, and what is left of it without the columns that show it."""

    def plan(**changes: object) -> Callable[[], Plan]:
        def make() -> Plan:
            first = as_plan(found(reference, RELAXED.get(reference, "softplus_dc+strict"))[0], scene_of(reference))
            return first.but(**changes)

        return make

    none: dict[str, object] = {"lam": None, "friction": None, "scheme": ""}
    astray = (*MOTION, *GOAL)
    return {
        "relaxed, as its method declares it": (plan(), (*FORCES, *astray)),
        "relaxed, its scheme not declared": (plan(scheme=""), (*FORCES, *astray)),
        "relaxed, its forces deleted": (plan(lam=None, friction=None), astray),
        "relaxed, forces and scheme deleted": (plan(**none), astray),
        "relaxed, velocities deleted": (plan(v=None, scheme=""), (*FORCES, *astray)),
        "relaxed, velocities and forces deleted": (plan(v=None, **none), astray),
        "relaxed, states deleted": (plan(q=None, v=None, scheme=""), (*FORCES, *astray)),
        "relaxed, inputs alone": (lambda: _astray(plan(q=None, v=None, **none)(), reference), astray),
        "relaxed, printed with two decimals": (plan(digits=2, scheme=""), (*FORCES, *astray)),
        "relaxed, true forces of its states": (lambda: _law(plan(scheme="")(), reference), astray),
    }


def _astray(plan: Plan, reference: str) -> Plan:
    """The plan, if its inputs do not reach what the scene asks for after all: inputs alone that do are no relaxed plan any more."""
    if not reaches(scene_of(reference), motion_of(reference).run(plan.t, plan.u), plan.u):
        raise NoPlanError("by an integration of its own its inputs do what the scene asks for")
    return plan


def _law(plan: Plan, reference: str) -> Plan:
    """Its forces replaced by those that the true law gives at its own positions."""
    assert plan.q is not None
    return plan.but(lam=motion_of(reference).forces(plan.q)[:-1])
