"""The Pyomo models themselves: what is in them, that they say what the compiled time step does.

Plans in and out of them, and their residuals. The model Ipopt is given is as large as on paper, on
every scene of the bank.
"""

import doctest
import importlib
import io
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyomo.environ as pyo
import pytest
import sympy as sp
from example_scenes import example_scene
from pyomo.mpec import Complementarity

from formulations import (
    ContactFormulation,
    ModelError,
    PlanResiduals,
    build_block,
    build_model,
    load_plan,
    read_plan,
    relax,
    set_relaxation,
)
from formulations.certificate.plan import certify_plan
from formulations.ipopt import compile_model
from formulations.pipelines import load_method, solve_scene
from formulations.solution import ModelSize, Outcome, Solution
from formulations.transcription.build import keep_within_depth, load_first_guess
from formulations.transcription.compiled import size_on_paper
from formulations.transcription.contact import hold_modes, release_modes
from models.catalog import load_scene, scene_names
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw as ForceLaw
from models.contact_law import RelaxationError
from models.errors import SceneError, TrajectoryError
from models.scene import Scene
from models.trajectory import Trajectory
from tests.formulations.transcription.rollouts import rolled_out

# A residual is a difference of numbers of this size: what rounding leaves, with two digits to
# spare.
ROUNDING = 1e-13


def in_contact(scene: Scene) -> Scene:
    """The scene started close to (or in) contact, so that forty steps see both modes."""
    starts = {
        "three_cart": (2.0, 2.48, 3.0, 0.3, 0.0, -0.2), "bouncing_mass": (0.01, -1.0),
        "two_body_collision": (0.0, 0.21, 2.0, -1.0),
        "two_link_arm": (0.9, -0.1, -1.5, 0.2),
    }  # fmt: skip
    return scene.with_task(start=starts.get(scene.name, scene.task.start), steps=40)


def probe_inputs(scene: Scene) -> dict[str, np.ndarray]:
    """Zeros, ones, 0101.., 0123.. and random inputs: the patterns find index mistakes."""
    steps, nu = scene.task.steps, scene.nu
    count = np.arange(steps * nu, dtype=float).reshape(steps, nu)
    return {
        "zeros": np.zeros((steps, nu)), "ones": np.ones((steps, nu)), "0101": count % 2,
        "0123": count / max(1, steps),
        "random": np.random.default_rng(7).normal(size=(steps, nu)),
    }  # fmt: skip


def largest_violation(model: pyo.ConcreteModel) -> float:
    """Of all active constraints and bounds but those of the goal."""
    worst = 0.0
    for row in model.component_data_objects(pyo.Constraint, active=True, descend_into=True):
        if "goal" not in row.name:
            worst = max(worst, -min(row.slack(), 0.0))
    for variable in model.component_data_objects(pyo.Var, descend_into=True):
        if variable.lb is not None and not variable.name.startswith(
            "variable_u"
        ):  # the probes go where they like
            worst = max(worst, variable.lb - variable.value)
    return worst


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["three_cart", "bouncing_mass", "two_body_collision", "two_link_arm", "oscillator"]
)
def test_rollout_satisfies_the_model(name: str) -> None:
    scene = in_contact(example_scene(name))
    for law, eps in (
        (ContactFormulation.SOFTPLUS, 1e-3),
        (ContactFormulation.COMPLEMENTARITY, 0.0),
    ):
        model = build_model(scene, law, eps=eps)
        for label, u in probe_inputs(scene).items():
            plan = rolled_out(
                scene,
                u,
                ForceLaw.SOFTPLUS if law is ContactFormulation.SOFTPLUS else ForceLaw.RELU,
                eps or None,
            )
            load_plan(model, plan)
            scale = max(1.0, float(np.abs(plan.lam).max(initial=0.0)), float(np.abs(plan.v).max()))
            assert largest_violation(model) <= ROUNDING * scale**2, (law, label)
            assert pyo.value(model.objective_cost) == pytest.approx(
                load_kernel(scene).cost(plan.q, plan.v, u), rel=1e-13, abs=1e-13
            )
            back = read_plan(model)
            for field in ("t", "q", "v", "u", "lam"):
                assert np.array_equal(getattr(back, field), getattr(plan, field)), field


@pytest.mark.slow
def test_probe_rollouts_see_contact() -> None:
    """Else the test above would hold for a model without any contact law."""
    for name in ("three_cart", "bouncing_mass", "two_body_collision", "two_link_arm"):
        scene = in_contact(example_scene(name))
        lam = rolled_out(scene, np.zeros((40, scene.nu)), ForceLaw.RELU, None).lam
        assert (lam > 0).any(), name
        assert (lam == 0).any(), name


def test_a_wrong_step_is_seen() -> None:
    scene = in_contact(example_scene("three_cart"))
    model = build_model(scene, ContactFormulation.COMPLEMENTARITY, eps=0.0)
    load_plan(model, rolled_out(scene, np.ones((40, 2)), ForceLaw.RELU, None))
    model.variable_v[20, "q2"].value += 1e-6
    assert largest_violation(model) >= 1e-9


@pytest.mark.slow
def test_what_a_scene_does_not_need_is_not_there() -> None:
    bouncing = build_model(
        example_scene("bouncing_mass"), ContactFormulation.SOFTPLUS, eps=1e-2, steps=2
    )
    bare = build_model(
        example_scene("oscillator"), ContactFormulation.COMPLEMENTARITY, eps=1e-2, steps=2
    )
    assert bouncing.component("variable_u") is None
    for absent in (
        "variable_u",
        "variable_lam",
        "parameter_scene",
        "complementarity_contact",
        "mpec_bound",
        "parameter_sharpness",
    ):
        assert bare.component(absent) is None, absent
    cart = build_model("three_cart", ContactFormulation.SOFTPLUS, eps=1e-2, steps=1)
    text = str(cart.constraint_velocity_step[0, "q1"].expr)
    for absent in ("sin", "q2]", "variable_q"):
        assert absent not in text, (
            "no trigonometry, no inertial coupling and no position in a cart's step"
        )
    arm = build_model(example_scene("two_link_arm"), ContactFormulation.SOFTPLUS, eps=1e-2, steps=1)
    assert "variable_v[1,q2]" in str(arm.constraint_velocity_step[0, "q1"].expr), (
        "a coupled mass matrix is multiplied, not inverted"
    )


def test_parameters_start_and_goal_are_data() -> None:
    model = build_model("three_cart", ContactFormulation.SOFTPLUS, eps=1e-3, steps=3)
    step, goal = model.constraint_velocity_step[1, "q1"], model.constraint_goal_position["q2"]
    model.variable_v[1, "q1"].value = 0.7
    before = pyo.value(step.body)
    model.parameter_scene["c"].value = 5.0
    assert pyo.value(step.body) == pytest.approx(before + 0.01 * 3.0 * 0.7, rel=1e-12)
    force = model.constraint_contact_softplus[0, "left"]
    law = pyo.value(force.body)
    model.parameter_scene["k"].value = 300.0
    assert pyo.value(force.body) != law
    model.parameter_goal_position["q2"].value = 9.0
    assert pyo.value(goal.upper) == 9.0
    model.parameter_start_velocity["q3"].value = -1.0
    assert pyo.value(model.constraint_start_velocity["q3"].lower) == -1.0
    model.parameter_step.value = 0.02
    assert pyo.value(step.body) == pytest.approx(-0.7 + 0.02 * 5.0 * 0.7, rel=1e-12)


def test_tightening_moves_the_bound_in_place() -> None:
    model = build_model("three_cart", ContactFormulation.COMPLEMENTARITY, eps=1e-2, steps=3)
    row = model.complementarity_contact[1, "right"].ccon
    assert pyo.value(row.upper) == 1e-2
    set_relaxation(model, 1e-5)
    assert model.complementarity_contact[1, "right"].ccon is row
    assert pyo.value(row.upper) == 1e-5
    set_relaxation(model, 0.0)
    assert pyo.value(row.upper) == 0.0
    soft = build_model("three_cart", ContactFormulation.SOFTPLUS, eps=1e-3, steps=3)
    set_relaxation(soft, 1e-7)
    assert pyo.value(soft.parameter_sharpness) == pytest.approx(7 * np.log(10))


def test_the_separation_force_starts_at_its_own_value(caplog: pytest.LogCaptureFixture) -> None:
    model = build_model("three_cart", ContactFormulation.COMPLEMENTARITY, eps=1e-2, steps=3)
    assert model.complementarity_contact[0, "left"].v.value == pytest.approx(30 * 0.5)
    pressed = load_scene("three_cart").with_task(start=(2.0, 2.45, 2.9, 0.0, 0.0, 0.0), steps=3)
    assert (
        build_model(pressed, ContactFormulation.COMPLEMENTARITY, eps=1e-2)
        .complementarity_contact[0, "left"]
        .v.value
        == 0.0
    )
    assert not caplog.records, "a guess outside its bounds is no reason for a warning each step"


def test_relaxing_twice_is_refused_and_a_clone_keeps_the_original() -> None:
    model = build_model("three_cart", ContactFormulation.COMPLEMENTARITY, steps=3)
    relaxed = model.clone()
    relax(relaxed, 1e-2)
    assert isinstance(model.complementarity_contact, Complementarity)
    assert model.component("mpec_bound") is None
    with pytest.raises(ModelError, match="set_relaxation"):
        relax(relaxed, 1e-3)
    with pytest.raises(ModelError, match="relax"):
        set_relaxation(model, 1e-3)
    with pytest.raises(ModelError, match="complementarity"):
        relax(build_model("three_cart", ContactFormulation.SOFTPLUS, eps=1e-2, steps=3), 1e-2)


@pytest.mark.parametrize("eps", [0.0, 1.0, -1e-3, float("nan"), None, "1e-3", True])
def test_impossible_sharpness_is_refused(eps) -> None:
    with pytest.raises(RelaxationError, match="0 < eps < 1"):
        build_model("three_cart", ContactFormulation.SOFTPLUS, eps=eps, steps=2)


@pytest.mark.parametrize("eps", [-1e-3, float("nan"), float("inf"), "1e-3", True])
def test_impossible_bounds_are_refused(eps) -> None:
    with pytest.raises(ModelError, match="at least 0"):
        build_model("three_cart", ContactFormulation.COMPLEMENTARITY, eps=eps, steps=2)


def test_what_is_no_scheme_and_a_model_without_a_plan_are_refused():
    wrong: Any = "radau_iia_2"
    with pytest.raises(
        ModelError, match=r"scheme is 'radau_iia_2', but must be one of .*Scheme\.RADAU_IIA_2"
    ):
        build_model("three_cart", scheme=wrong)
    plan = read_plan(build_model("three_cart", steps=5))
    for use in (read_plan, lambda model: load_plan(model, plan)):
        with pytest.raises(
            ModelError,
            match="model unknown holds no plan: it must come from build_model or build_block",
        ):
            use(pyo.ConcreteModel())
    solution: Any = Solution(method="mpcc", outcome=Outcome.SOLVED)
    with pytest.raises(TrajectoryError, match="a Solution is no plan; give a Trajectory"):
        load_plan(build_model("three_cart", steps=5), solution)
    no_scene: Any = build_model("three_cart", steps=5)
    for use in (
        PlanResiduals,
        lambda scene: build_model(scene),
        lambda scene: certify_plan(scene, plan),
    ):
        with pytest.raises(
            SceneError,
            match="a ConcreteModel is no scene; give the name of one, the path of its file or a Scene",
        ):
            use(no_scene)
    assert PlanResiduals("three_cart").of(plan)["start_error"] == 0.0


def test_a_function_that_pyomo_does_not_have_is_refused_by_name() -> None:
    scene = load_scene("three_cart")
    v2, v3 = sp.symbols("v2 v3", real=True)
    rough = replace(
        scene,
        forces=(*scene.forces[:2], scene.forces[2] - sp.atan2(v3, v2 - 1)),
    )
    with pytest.raises(SceneError, match=r"atan2\(v3, v2 - 1\)"):
        build_model(rough, ContactFormulation.SOFTPLUS, eps=1e-2, steps=2)
    with pytest.raises(ModelError, match="ContactFormulation"):
        build_model("three_cart", "softplus", eps=1e-2)  # pyright: ignore[reportArgumentType]


def test_other_solvers_can_read_the_models(tmp_path: Path) -> None:
    """Pyomo's own writers: NL for the relaxed models, complementarity rows for PATH or Knitro, and a mixed-integer LP file."""
    for contact in ContactFormulation:
        model = build_model("three_cart", contact, eps=1e-2, steps=4)
        model.own = pyo.Constraint(expr=model.variable_q[2, "q2"] <= 3.2)
        model.write(str(tmp_path / "model.nl"), format="nl_v2")
        assert (tmp_path / "model.nl").read_text().startswith("g3")
    pairs = build_model("three_cart", ContactFormulation.COMPLEMENTARITY, steps=4)
    pyo.TransformationFactory("mpec.nl").apply_to(pairs)
    pairs.write(str(tmp_path / "pairs.nl"), format="nl_v1")
    complements = re.findall(r"^5 1 \d+$", (tmp_path / "pairs.nl").read_text(), flags=re.MULTILINE)
    assert len(complements) == 8, "one complementarity row for each of 2 contacts at 4 times"
    binary = build_model("three_cart", ContactFormulation.COMPLEMENTARITY, steps=4)
    pyo.TransformationFactory("mpec.simple_disjunction").apply_to(binary)
    pyo.TransformationFactory("gdp.bigm").apply_to(binary, bigM=1e3)
    binary.write(str(tmp_path / "binary.lp"))
    assert "binary" in (tmp_path / "binary.lp").read_text()


def test_a_block_holds_one_plan() -> None:
    model = build_model("three_cart", ContactFormulation.SOFTPLUS, eps=1e-3, steps=3)
    with pytest.raises(ModelError, match="three_cart holds a plan already"):
        build_block(model, "three_cart", ContactFormulation.SOFTPLUS, eps=1e-3, steps=3)


def test_two_blocks_live_in_one_model() -> None:
    model = pyo.ConcreteModel()
    model.first, model.second = pyo.Block(), pyo.Block()
    build_block(model.first, "three_cart", ContactFormulation.COMPLEMENTARITY, eps=1e-2, steps=3)
    build_block(model.second, "three_cart", ContactFormulation.COMPLEMENTARITY, eps=1e-3, steps=3)
    set_relaxation(model.first, 1e-6)
    bounds = [
        pyo.value(block.complementarity_contact[0, "left"].ccon.upper)
        for block in (model.first, model.second)
    ]
    assert bounds == [1e-6, 1e-3]
    assert next(model.component_data_objects(pyo.Objective, active=True), None) is None
    model.cost = pyo.Objective(expr=model.first.expression_cost + model.second.expression_cost)
    model.pprint(ostream=io.StringIO())


@pytest.mark.parametrize("module", ["build"])
def test_examples_in_docstrings(module: str) -> None:
    results = doctest.testmod(importlib.import_module(f"formulations.transcription.{module}"))
    assert results.attempted > 5
    assert results.failed == 0


@pytest.mark.slow
def test_importing_formulations_and_its_methods_costs_neither_pyomo_nor_torch() -> None:
    code = (
        "import sys, formulations, formulations.pipelines as c; [c.load_method(n) for n in c.method_names()];"
        "sys.exit(','.join(m for m in ('pyomo', 'torch') if m in sys.modules) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


SCENE = load_scene("three_cart").with_task(start=(2.0, 2.48, 3.0, 0.3, 0.0, -0.2), steps=40)


def plan_of(law: ForceLaw = ForceLaw.RELU, eps: float | None = None) -> Trajectory:
    return rolled_out(SCENE, np.random.default_rng(3).normal(size=(40, 2)), law, eps)


def changed(plan: Trajectory, field: str, where: tuple[int, int], by: float) -> Trajectory:
    arrays = {name: np.array(getattr(plan, name)) for name in ("t", "q", "v", "u", "lam")}
    arrays[field][where] += by
    return Trajectory(**arrays)


def test_a_rollout_has_no_residuals() -> None:
    residuals = PlanResiduals(SCENE).of(plan_of())
    assert (
        max(
            residuals[name]
            for name in (
                "dynamics_defect",
                "start_error",
                "input_bound_excess",
                "force_sign",
                "complementarity",
            )
        )
        < 1e-13
    )
    assert residuals["terminal_error"] > 0.1
    soft = PlanResiduals(SCENE).of(plan_of(ForceLaw.SOFTPLUS, 1e-3), ForceLaw.SOFTPLUS, 1e-3)
    assert soft["contact_law"] < 1e-13
    assert soft["physics"] > 1.0


@pytest.mark.parametrize(("field", "where", "by", "figure", "least"), [
    ("q", (40, 0), 1e-3, "dynamics_defect", 9e-4), ("v", (40, 2), 1e-3, "dynamics_defect", 9e-4),
    ("q", (0, 1), 1e-3, "start_error", 9e-4),
    ("u", (7, 0), 20.0, "input_bound_excess", 5.0), ("lam", (39, 1), -50.0, "force_sign", 10.0),
    ("lam", (0, 0), 1.0, "complementarity", 0.5),
])  # fmt: skip
def test_each_residual_sees_its_own_fault(field, where, by, figure, least) -> None:
    functions = PlanResiduals(SCENE)
    assert functions.of(plan_of())[figure] < 1e-13
    assert functions.of(changed(plan_of(), field, where, by))[figure] > least


def test_plans_that_do_not_fit_are_refused() -> None:
    model = build_model(SCENE, ContactFormulation.SOFTPLUS, eps=1e-3)
    with pytest.raises(TrajectoryError, match="resample"):
        load_plan(build_model(SCENE, ContactFormulation.SOFTPLUS, eps=1e-3, steps=39), plan_of())
    with pytest.raises(TrajectoryError, match="resample"):
        load_plan(build_model(SCENE, ContactFormulation.SOFTPLUS, eps=1e-3, step=0.02), plan_of())
    plan = plan_of()
    with pytest.raises(TrajectoryError, match="u has 1 columns"):
        load_plan(model, Trajectory(t=plan.t, q=plan.q, v=plan.v, u=plan.u[:, :1], lam=plan.lam))
    with pytest.raises(TrajectoryError, match="lam has 0 columns"):
        load_plan(model, Trajectory(t=plan.t, q=plan.q, v=plan.v, u=plan.u, lam=plan.lam[:, :0]))


def test_the_first_guess_is_that_of_the_paper() -> None:
    model = build_model(SCENE, ContactFormulation.COMPLEMENTARITY, eps=1e-2)
    fresh = read_plan(model)
    load_plan(model, plan_of())
    load_first_guess(model)
    again = read_plan(model)
    for plan in (fresh, again):
        assert np.array_equal(plan.q, np.tile(SCENE.task.start[:3], (41, 1)))
        assert np.array_equal(plan.v, np.tile(SCENE.task.start[3:], (41, 1)))
        assert not plan.u.any()
        assert not plan.lam.any()


def test_held_modes_decide_every_pair_and_are_released_again() -> None:
    model = build_model(SCENE, ContactFormulation.COMPLEMENTARITY, eps=1e-2)
    closed = PlanResiduals(SCENE).modes(plan_of())
    assert closed.any()
    assert not closed.all()
    hold_modes(model, closed)
    for (t, name), pair in model.complementarity_contact.items():
        column = 0 if name == "left" else 1
        assert (pair.v.ub, model.variable_lam[t, name].ub) == (
            (0.0, None) if closed[t, column] else (None, 0.0)
        )
        assert not pair.ccon.active
    release_modes(model)
    assert all(
        pair.ccon.active and pair.v.ub is None for pair in model.complementarity_contact.values()
    )
    assert all(lam.ub is None for lam in model.variable_lam.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    "contact", [ContactFormulation.SOFTPLUS, ContactFormulation.COMPLEMENTARITY]
)
@pytest.mark.parametrize("name", scene_names())
def test_no_unknown_and_no_equation_too_many(name: str, contact: ContactFormulation):
    for steps in (1, 6):
        scene = load_scene(name).with_task(steps=steps)
        problem = compile_model(build_model(scene, contact, eps=1e-2))
        assert ModelSize(unknowns=problem.n, equations=problem.m) == size_on_paper(scene, contact)


def test_counts_by_hand_of_the_papers_scene():
    """6 states at 501 nodes, 2 inputs and 2 forces a step; 12 ends, 6 + 2 equations a step.

    complementarity: two more of each a step.
    """
    scene = load_scene("three_cart")
    assert size_on_paper(scene, ContactFormulation.SOFTPLUS) == ModelSize(
        unknowns=6 * 501 + 4 * 500, equations=12 + 8 * 500
    )
    assert size_on_paper(scene, ContactFormulation.COMPLEMENTARITY) == ModelSize(
        unknowns=6 * 501 + 6 * 500, equations=12 + 10 * 500
    )


@pytest.mark.parametrize("method", ["softplus_dc", "relaxed_lcp", "strict_lcp"])
def test_a_solution_says_how_large_its_model_was(method: str):
    scene = load_scene("wall_pendulum")
    found = load_method(method)
    eps = None if method == "strict_lcp" else 1e-2
    solution = found.open(scene).solve(eps=eps, warm_start=None, time_limit=60.0)
    assert solution.size is not None
    assert solution.size == solution.paper_size


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"epsilon": 1e-3}, "build_model: there is no argument 'epsilon'; did you mean eps?"),
        ({"scene": "three_cart"}, "build_model: multiple values for argument 'scene'; it takes"),
    ],
)
def test_build_model_wrong_argument_is_one_sentence(given, words: str):
    with pytest.raises(SceneError, match=re.escape(words)):
        build_model("three_cart", ContactFormulation.SOFTPLUS, **given)


def test_a_plan_within_the_depths_has_a_row_for_each_node_and_contact():
    scene = load_scene("three_cart").with_task(steps=20)
    model = build_model(scene)
    keep_within_depth(model, scene, 0.5)
    assert len(model.constraint_depth) == 20 * scene.nc
    phi = load_kernel(scene).penetration(np.array([scene.task.start[: scene.nq]]))[0]
    for (t, name), row in model.constraint_depth.items():
        contact = [item.name for item in scene.contacts].index(name)
        assert t >= 1
        assert pyo.value(row.upper - row.body) == pytest.approx(
            0.5 * scene.depths[contact] - phi[contact]
        )
    with pytest.raises(ModelError, match=r"above 0 and at most 1"):
        keep_within_depth(build_model(scene), scene, 1.5)


def test_strict_contact_keeps_to_a_share_of_the_depth():
    """Half as deep as the cheapest plan goes, at a higher cost."""
    scene = load_scene("three_cart").with_task(
        start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
    )
    free = solve_scene(scene, "strict")
    share = 0.5 * _deepest(scene, free) / min(scene.depths)
    kept = solve_scene(scene, "strict_lcp", options={"depth_share": share})
    assert kept.outcome is Outcome.SOLVED
    assert _deepest(scene, kept) <= 0.5 * _deepest(scene, free) + 1e-8
    assert kept.cost > free.cost


def _deepest(scene: Scene, found: Solution) -> float:
    return float(load_kernel(scene).penetration(found.trajectory.q).max())
