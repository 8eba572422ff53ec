"""What every method must do, run over the catalog: a new file in formulations/methods is tested by existing. Options; promises of a plan that is called solved, broken on purpose; scenes that are impossible; the free motion of those without inputs; and what a free end and bounds of velocities mean to every back end."""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
import pyomo.environ as pyo
import pytest
import sympy as sp
from example_scenes import example_scene
from wording import unsaid

from formulations import ContactFormulation, build_model
from formulations.method import Clock, Kind, Method, OptionError, Options, Session, option
from formulations.methods.mpcc import MpccOptions
from formulations.methods.softplus_dc import SoftplusDCOptions
from formulations.pipelines import PIPELINES, load_method, method_names, pipelines_for, solve_scene
from formulations.solution import Outcome, Solution
from formulations.transcription.residuals import PlanResiduals
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import SceneError, TrajectoryError
from models.fmu import build_fmu
from models.scene import Scene
from models.scene.goal import distance, goal_state, miss
from models.scene.parts import goal_limits
from models.trajectory import Trajectory, uniform_grid
from validate.judge.judgement import judge
from validate.judge.score import score

# What plans: every method but the free motion, which is for scenes that leave nothing to plan (the
# last tests here).
ALL = tuple(name for name in method_names() if name != "free_motion")
BARE = example_scene("oscillator")
SCENE = load_scene("three_cart").with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100
)
# The same for a method that says why SCENE is too much for it.
LITTLE = SCENE.with_task(steps=6, step=0.15)
PENDULUM = load_scene("wall_pendulum")
# What a method may be begun with: a plan of each kind, of each mathematics behind it.
PLANS = ("softplus_dc", "relaxed_lcp", "strict_lcp", "relu_gd")
# Options that make little work of a method, where it has them: what is tested here holds for few
# iterations as for many.
FEW = {"iterations": 5, "tolerances": (0.0, 0.05), "worlds": 2}


def scene_for(*names: str) -> Scene:
    """The scene that all these methods accept."""
    return SCENE if all(load_method(name).accepts(SCENE) is None for name in names) else LITTLE


def solved(method: Method, scene: Scene, warm_start: Trajectory | None = None) -> Solution:
    few = {item.name: FEW[item.name] for item in fields(method.options) if item.name in FEW}
    with method.open(scene, few) as session:
        return session.solve(
            eps=1e-2 if method.needs_eps else None, warm_start=warm_start, time_limit=600.0
        )


@cache
def first(name: str, scene: Scene) -> Solution:
    """What it finds from a cold start; it is looked at by several tests."""
    found = solved(load_method(name), scene)
    assert found.trajectory is not None
    return found


def test_there_are_methods() -> None:
    assert {"softplus_dc", "relaxed_lcp", "strict_lcp"} <= set(ALL)


@pytest.mark.parametrize("name", ALL)
def test_it_says_what_it_is(name: str) -> None:
    method = load_method(name)
    assert method.name == name
    assert re.fullmatch(r"[a-z][a-z0-9_]*", name)
    assert method.title
    assert isinstance(method.kind, Kind)
    assert isinstance(method.needs_eps, bool)
    for item in fields(method.options):
        assert item.metadata["description"], item.name
    assert method.read_options({}) == method.options()


@pytest.mark.parametrize("name", ALL)
def test_it_refuses_a_scene_without_inputs_with_a_reason(name: str) -> None:
    method = load_method(name)
    assert method.accepts(scene_for(name)) is None
    reason = method.accepts(BARE)
    assert isinstance(reason, str)
    assert "input" in reason
    with pytest.raises(OptionError, match="input"):
        method.open(BARE)


@pytest.mark.parametrize("name", ALL)
def test_it_refuses_options_it_does_not_know(name: str) -> None:
    with pytest.raises(OptionError, match="colour"):
        load_method(name).open(scene_for(name), {"colour": "red"})


@pytest.mark.parametrize("name", ALL)
def test_it_checks_eps_and_the_time_limit(name: str) -> None:
    method = load_method(name)
    with method.open(scene_for(name)) as session:
        for wrong in (0.0, 1.0, -1e-3, float("nan"), None) if method.needs_eps else (1e-2,):
            with pytest.raises(
                OptionError, match="0 < eps < 1" if method.needs_eps else "takes no eps"
            ):
                session.solve(eps=wrong, warm_start=None, time_limit=1.0)
        with pytest.raises(OptionError, match="time limit"):
            session.solve(eps=1e-2 if method.needs_eps else None, warm_start=None, time_limit=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_its_answer_is_whole(name: str) -> None:
    scene = scene_for(name)
    solution = first(name, scene)
    assert isinstance(solution, Solution)
    assert solution.method == name
    assert isinstance(solution.outcome, Outcome)
    assert solution.outcome.has_answer, solution.message
    plan = solution.trajectory
    plan.check_fits(scene)
    assert plan.steps == scene.task.steps
    assert plan.has_uniform_grid()
    for array in (plan.t, plan.q, plan.v, plan.u, plan.lam):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(plan.start, scene.task.start, rtol=0, atol=1e-9)
    assert solution.cost == pytest.approx(float((plan.u**2).sum()), rel=1e-12)
    assert solution.iterations >= 0
    assert set(solution.options) == set(asdict(load_method(name).options()))
    assert solution.residuals
    assert all(np.isfinite(value) for value in solution.residuals.values())
    assert "terminal_error" in solution.residuals
    assert len({len(column) for column in solution.history.values()}) <= 1, (
        "columns of a history, if there is one, are equally long"
    )
    assert all(np.isfinite(column).all() for column in solution.history.values())
    seconds = solution.seconds
    assert min(seconds.build, seconds.translate, seconds.evaluate, seconds.linear_algebra) >= 0
    assert seconds.wall > 0
    assert solution.solver or not seconds.translate, "what a model was translated for is named"
    assert (
        seconds.build + seconds.translate + seconds.evaluate + seconds.linear_algebra
        <= seconds.wall * 1.001 + 1e-3
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_it_repeats_itself_bit_for_bit(name: str) -> None:
    scene = scene_for(name)
    one, two = first(name, scene), solved(load_method(name), scene)
    assert (one.outcome, one.iterations, one.residuals, one.history) == (
        two.outcome,
        two.iterations,
        two.residuals,
        two.history,
    )
    for field in ("t", "q", "v", "u", "lam"):
        assert np.array_equal(getattr(one.trajectory, field), getattr(two.trajectory, field)), field


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_it_starts_from_the_plan_of_any_other(name: str) -> None:
    for other in PLANS:
        scene = scene_for(name, other)
        assert (
            solved(load_method(name), scene, first(other, scene).trajectory).trajectory is not None
        ), other


def resting(scene: Scene) -> Trajectory:
    """A plan of the scene's shape, with zeros in it."""
    steps = scene.task.steps
    return Trajectory(
        t=uniform_grid(scene.task.step, steps),
        q=np.zeros((steps + 1, scene.nq)),
        v=np.zeros((steps + 1, scene.nq)),
        u=np.zeros((steps, scene.nu)),
        lam=np.zeros((steps, scene.nl)),
    )


@pytest.mark.parametrize("name", ALL)
def test_it_refuses_a_plan_that_does_not_fit(name: str) -> None:
    scene = scene_for(name)
    task = scene.task
    shorter = scene.with_task(steps=task.steps - 1)
    other = load_scene("cart_pole_walls").with_task(step=task.step, steps=task.steps)
    for planned, word in ((shorter, "steps"), (other, "columns")):
        with pytest.raises(TrajectoryError, match=word):
            solved(load_method(name), scene, resting(planned))


@dataclass(frozen=True, kw_only=True)
class _Base(Options):
    weight: float = option(1.0, "of the goal", lower=0.0, unit="kg")


@dataclass(frozen=True, kw_only=True)
class _Own(_Base):
    rounds: int = option(3, "most rounds", lower=1, upper=10)
    search: bool = option(True, "whether to search")
    guess: str = option("line", "where it starts", choices=("line", "start"))
    most: int | None = option(None, "none: no limit", lower=1)


class _OwnMethod(Method[_Own]):
    name = "m"
    options = _Own

    def session(self, scene: Scene, options: _Own, clock: Clock) -> Session:
        raise NotImplementedError


def test_defaults_are_filled_in_and_values_kept_as_they_were_given():
    assert list(asdict(_Own())) == ["weight", "rounds", "search", "guess", "most"]
    read_options = _OwnMethod().read_options
    assert repr(read_options({"weight": 2, "search": False}).weight) == "2", (
        "keys of stored results hold what was given"
    )
    assert read_options(_Own(rounds=2)) == read_options({"rounds": 2}) == _Own(rounds=2)


@pytest.mark.parametrize(("given", "sentence"), [
    ({"round": 1}, "method m: … no option 'round'; did you mean rounds?"),
    ({"colour": 1}, "method m: … no option 'colour'; it has weight, rounds, search, guess, most."),
    ({"rounds": 11}, "method m: option rounds is 11 … [1, 10]"),
    ({"rounds": 2.0}, "method m: option rounds is 2.0 … whole number"),
    ({"weight": True}, "method m: option weight is True … [0, inf] kg"),
    ({"weight": None}, "method m: option weight is None … [0, inf] kg"),
    ({"search": "no"}, "method m: option search is 'no' … True, False"),
    ({"guess": "end"}, "method m: option guess is 'end' … 'line', 'start'"),
    (_Base(), "method m: … _Own, but _Base were given"),
])  # fmt: skip
def test_one_sentence_says_what_is_wrong(given, sentence):
    with pytest.raises(OptionError) as caught:
        _OwnMethod().read_options(given)
    assert not unsaid(caught.value, sentence)


def test_what_is_impossible_only_for_one_method_is_refused_too():
    words = "method relu_gd: option iterations is 2.5, but must be a whole number or left out"
    with pytest.raises(OptionError, match=words):
        load_method("relu_gd").read_options({"iterations": 2.5})


def test_an_object_is_checked_when_it_is_made_and_belongs_to_its_method():
    with pytest.raises(OptionError, match="option search is 3"):
        MpccOptions(search=3)  # pyright: ignore[reportArgumentType] - what is tested
    assert load_method("mpcc").read_options(MpccOptions(search=False)).search is False
    with pytest.raises(OptionError, match="are MpccOptions, but SoftplusDCOptions"):
        load_method("mpcc").read_options(SoftplusDCOptions())


COMMON = (
    "dynamics_defect",
    "start_error",
    "terminal_error",
    "input_bound_excess",
    "velocity_bound_excess",
)
PROMISED = {
    "softplus_dc": (*COMMON, "contact_law", "regularised_friction"),
    "relaxed_lcp": (*COMMON, "complementarity", "force_sign", "friction_cone", "friction_law"),
    "strict_lcp": (*COMMON, "force_sign", "friction_cone", "friction_law", "physics"),
    "mpcc": (*COMMON, "force_sign"), "collocation": COMMON,
}  # fmt: skip
# Options that say how large a residual may be, where it is not the method's plan_tolerance; and
# what the relaxation adds.
LIMITED_BY = {
    ("strict_lcp", "physics"): ("physics_tolerance",),
    ("strict_lcp", "terminal_error"): ("terminal_tolerance",),
    ("mpcc", "terminal_error"): ("terminal_tolerance",),
}
RELAXED = {("relaxed_lcp", "complementarity"): 1e-2, ("relaxed_lcp", "friction_law"): 2e-2}


def limit(name: str, residual: str) -> float:
    options = asdict(load_method(name).options())
    return RELAXED.get((name, residual), 0.0) + sum(
        options[item] for item in LIMITED_BY.get((name, residual), ("plan_tolerance",))
    )


def told(monkeypatch: pytest.MonkeyPatch, residual: str, value: float) -> None:
    """Every plan is told to miss this residual by that much."""
    true = PlanResiduals.of
    monkeypatch.setattr(
        PlanResiduals, "of", lambda *given, **named: {**true(*given, **named), residual: value}
    )


@pytest.mark.parametrize("name", PROMISED)
def test_it_is_solved_where_nothing_is_broken(name: str):
    found = solved(load_method(name), PENDULUM)
    assert found.outcome is Outcome.SOLVED, found.message
    assert "Checked on the plan itself" not in found.message


@pytest.mark.parametrize(
    ("name", "residual"),
    [(name, residual) for name, residuals in PROMISED.items() for residual in residuals],
)
def test_a_broken_promise_is_no_solution(name: str, residual: str, monkeypatch: pytest.MonkeyPatch):
    told(monkeypatch, residual, 1.01 * limit(name, residual))
    found = solved(load_method(name), PENDULUM)
    assert found.outcome is Outcome.STALLED
    assert "Checked on the plan itself" in found.message
    assert f"{residual} is " in found.message
    told(monkeypatch, residual, 0.99 * limit(name, residual))
    assert solved(load_method(name), PENDULUM).outcome is Outcome.SOLVED


def judged(scene: Scene) -> Any:
    steps = scene.task.steps
    still = np.tile(np.array(scene.task.start), (steps + 1, 1))
    return judge(
        scene,
        Trajectory(
            t=scene.task.step * np.arange(steps + 1), q=still[:, : scene.nq],
            v=still[:, scene.nq :], u=np.zeros((steps, scene.nu)),
            lam=np.zeros((steps, scene.nl)),
        ),
    )  # fmt: skip


def planned(name: str) -> Callable[[Scene], Any]:
    def plan(scene: Scene) -> Any:
        method = load_method(name)
        if (reason := method.accepts(scene)) is not None:
            pytest.skip(reason)
        with method.open(scene, {}) as session:
            return session.solve(
                eps=1e-2 if method.needs_eps else None, warm_start=None, time_limit=1.0
            )

    return plan


USES = {
    "kernel": load_kernel, "FMU": build_fmu, "judge": judged,
    "Pyomo": lambda scene: build_model(scene, ContactFormulation.SOFTPLUS, eps=1e-3),
    **{name: planned(name) for name in method_names()},
}  # fmt: skip


@pytest.mark.parametrize("use", USES.values(), ids=USES.keys())
def test_an_impossible_scene_is_refused(use: Callable[[Scene], Any]):
    scene = load_scene("three_cart").with_task(steps=5)
    endless = scene.potential_energy + sp.log(scene.coordinates[0].symbol - scene.task.start[0])
    with pytest.raises(
        SceneError, match=r"^scene three_cart: potential_energy is zoo at the start"
    ):
        use(replace(scene, potential_energy=endless))


METHOD = load_method("free_motion")


@pytest.mark.parametrize("name", ["bouncing_mass", "two_body_collision"])
def test_it_is_the_scenes_own_time_step_with_true_contact(name: str):
    scene = load_scene(name)
    solution = solve_scene(scene, "free_motion")
    assert solution.outcome is Outcome.SOLVED
    assert METHOD.kind is Kind.DIRECT
    plan = solution.trajectory
    expected = load_kernel(scene).rollout(
        np.array(scene.task.start), np.zeros((scene.task.steps, 0)), scene.task.step
    )
    assert np.array_equal(plan.q, expected.q)
    assert np.array_equal(plan.lam, expected.lam)
    assert plan.lam.max() > 1.0
    assert solution.cost == 0.0


def test_a_scene_with_inputs_is_refused_with_a_reason():
    scene = load_scene("three_cart")
    assert "has inputs" in str(METHOD.accepts(scene))
    with pytest.raises(OptionError, match="free_motion: scene three_cart has inputs"):
        METHOD.open(scene)


def test_a_step_beyond_the_stability_limit_diverges_and_says_so():
    oscillator = example_scene("oscillator")
    scene = oscillator.with_task(step=3.0, steps=2000)  # h w = 3, beyond 2
    solution = solve_scene(scene, "free_motion")
    assert solution.outcome is Outcome.DIVERGED
    assert solution.trajectory is None
    assert "use a smaller one" in solution.message


def test_it_is_tried_only_where_nothing_can_be_planned():
    assert "free_motion" not in [
        pipeline.name for pipeline in pipelines_for(load_scene("three_cart"))
    ]
    assert "free_motion" in [
        pipeline.name for pipeline in pipelines_for(load_scene("bouncing_mass"))
    ]


def test_what_wins_nowhere_is_run_unasked_on_the_papers_scene_only():
    others = [pipeline for pipeline in PIPELINES if pipeline.only != "three_cart"]
    assert {pipeline.name for pipeline in PIPELINES} - {pipeline.name for pipeline in others} == {
        "softplus_gd+strict"
    }
    assert pipelines_for(load_scene("bouncing_mass")) == tuple(others)


def test_eps_is_refused():
    with (
        METHOD.open(load_scene("bouncing_mass")) as session,
        pytest.raises(OptionError, match="takes no eps"),
    ):
        session.solve(eps=0.1, warm_start=None, time_limit=1.0)


# Of a goal is asked how near is near enough.
ASKED = replace(
    PENDULUM,
    limits=(*PENDULUM.limits, *goal_limits(position=0.01, velocity=0.01, reason="this test")),
)


def bounded(lower: float, upper: float) -> Scene:
    return replace(
        PENDULUM,
        coordinates=(replace(PENDULUM.coordinates[0], velocity_lower=lower, velocity_upper=upper),),
    )


def plan_by(name: str, scene: Scene) -> Solution:
    solution = solved(load_method(name), scene)
    assert solution.outcome is Outcome.SOLVED, solution.message
    return solution


def both(scene: Scene) -> tuple[Solution, Solution]:
    """By the banded quadratic program of fixed modes and by Ipopt on the Pyomo model: they share no line."""
    first, second = plan_by("mpcc", scene), plan_by("strict_lcp", scene)
    assert first.cost == pytest.approx(second.cost, rel=1e-6)
    return first, second


def test_a_free_end_misses_nothing():
    goal = goal_state(PENDULUM.task)
    assert np.isnan(goal).all()
    assert miss(np.array([3.0, 4.0]), goal).tolist() == [0.0, 0.0]
    assert distance(np.array([3.0, 4.0]), np.array([np.nan, 1.0])) == 3.0
    assert build_model(PENDULUM, eps=1e-3).component("constraint_goal_position") is None
    (first, _) = both(PENDULUM)
    assert first.cost == pytest.approx(PENDULUM.answers[0].value, rel=1e-9)
    assert first.trajectory is not None
    metrics = {metric.name for metric in score(PENDULUM, first.trajectory, None).metrics}
    assert "velocity_bound_violation" in metrics
    assert not {name for name in metrics if "terminal" in name}


@pytest.mark.parametrize("goal", [(0.15, None), (None, 0.6), (0.15, 0.6)])
def test_a_component_of_the_end_may_be_given(goal):
    scene = ASKED.with_task(goal=goal)
    for solution in both(scene):
        assert distance(solution.trajectory.end, goal_state(scene.task)) <= 1e-8
        assert solution.cost > PENDULUM.answers[0].value
    given = [
        name
        for name in ("position", "velocity")
        if build_model(scene, eps=1e-3).component(f"constraint_goal_{name}") is not None
    ]
    assert given == [
        name
        for name, value in zip(("position", "velocity"), goal, strict=True)
        if value is not None
    ]


@pytest.mark.parametrize(("lower", "upper"), [(0.78, 1.5), (-1.5, 0.83)])
def test_velocity_bounds_hold_at_the_start_of_every_step(lower: float, upper: float):
    for solution in both(bounded(lower, upper)):
        v = solution.trajectory.v[:-1]
        assert v.min() >= lower - 1e-7
        assert v.max() <= upper + 1e-7
        assert min(abs(v.min() - lower), abs(v.max() - upper)) <= 1e-7, (
            "the bound was meant to be active"
        )
        assert solution.residuals["velocity_bound_excess"] <= 1e-7
    tight = bounded(lower, upper)
    free = plan_by("mpcc", PENDULUM).trajectory
    metric = score(tight, free, None).metric("velocity_bound_violation")
    assert metric.ok is False
    assert metric.value == pytest.approx(max(lower - free.v[:-1].min(), free.v[:-1].max() - upper))
    model = build_model(tight, eps=1e-3)
    assert (
        pyo.value(model.variable_v[3, "theta"].lb),
        pyo.value(model.variable_v[3, "theta"].ub),
    ) == (lower, upper)
    assert model.variable_v[20, "theta"].lb is None


def test_impossible_bounds_are_refused():
    with pytest.raises(SceneError, match="velocity_lower must be below velocity_upper"):
        bounded(1.0, -1.0)
    with pytest.raises(SceneError, match=r"omega = 0\.8, outside its bounds"):
        bounded(-0.5, 0.5)
    with pytest.raises(SceneError, match=r"start\[0\]"):
        PENDULUM.with_task(start=(None, 0.8))
