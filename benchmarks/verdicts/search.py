"""A search for plans that cheat the judge, over many scenes: mutations of good and of relaxed plans, and an oracle that says what is truly wrong.

A plan is mutated a few times - stretched in time, thinned until bodies pass through each other
between its nodes, pulses put between nodes, forces scaled or invented, columns deleted, schemes and
holds declared, cut, lengthened, shifted, printed coarsely - and written as a CSV. `Oracle`
integrates the inputs of that very text from the task's start by `motion` and calls it wrong only
with a wide margin: the goal missed by more than twice its limit, states off by five times theirs,
forces by a factor. What the judge lets pass of those is a find. Those that fail the fewest metrics
have children.
"""

from __future__ import annotations

import csv
import time
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.verdicts.exact import BASES
from benchmarks.verdicts.mutations import mutate
from benchmarks.verdicts.plans import (
    BROKEN,
    NoPlanError,
    Plan,
    Said,
    as_plan,
    cost,
    exact,
    found,
    goal_limits,
    judged_in_time,
    miss,
    motion_of,
    scene_of,
)
from models.scene import Scene

# Where the good and the relaxed plans come from; of others "strict" and "softplus_dc+strict".
GOOD = {**BASES, "two_discs_wall": "relu_gd", "hopper_planar": "multiple_shooting"}
RELAXED = {"transport": "lbfgs", "hopper_planar": "multiple_shooting"}
HOLDS = "holds"
WITH_FEEDBACK = "holds with feedback"
# By how much more than its limit a plan must be off for the oracle to call it wrong.
MISS = 2.0
OFF = 5.0
# Most plans that are tried for each wrong one that is asked for: a mutation may leave a plan right.
PATIENCE = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Try:
    """A plan, how it came to be, what is truly wrong with it ("" if nothing is sure), what the judge said, how many metrics it fails."""

    plan: Plan
    made: tuple[str, ...]
    wrong: str
    said: Said
    fails: int


class Oracle:
    """What is truly wrong with a plan of a scene, of which nothing is known but its text."""

    def __init__(self, reference: str) -> None:
        self.scene, self.motion = scene_of(reference), motion_of(reference)

    def wrong(self, text: str, judged_with_feedback: bool = False) -> str:
        """Why, or "" where nothing is wrong by a wide margin.

        Of a plan that needs feedback the open loop says nothing of the goal and the states.
        """
        scene = self.scene
        said = _columns(text, scene)
        t, u, step = said["t"], said["u"], scene.task.step
        if not (np.diff(t) > 0).all() or not all(
            np.isfinite(rows).all() for key, rows in said.items() if isinstance(rows, np.ndarray)
        ):
            return "no times that increase, or no numbers"
        if abs(t[-1] - t[0] - scene.task.horizon) > 1.5 * step:
            return f"it lasts {t[-1] - t[0]:.4g} s of {scene.task.horizon:g} s"
        printed = said["quantum"]
        for index, item in enumerate(scene.inputs):
            beyond = max(
                float(u[:, index].max()) - item.upper, item.lower - float(u[:, index].min())
            )
            if beyond > OFF * (1e-6 * (item.upper - item.lower) + printed):
                return f"{item.name} is {beyond:.3g} beyond its bounds"
        nominal = np.array([item.nominal for item in scene.coordinates])
        if "q" in said:
            start = np.abs(said["q"][0] - scene.task.start[: scene.nq]) / nominal
            if (start > OFF * (1e-6 + printed / nominal)).any():
                return f"it starts {start.max():.3g} of nominal elsewhere"
        linear = said["u_end"] if said["hold"] == "linear" else None
        path = self.motion.run(t, u, linear_to=linear, rtol=1e-9)
        if not path.ended:
            return "" if judged_with_feedback else "its motion runs away"
        for contact, depth, most in zip(scene.contacts, path.depth, scene.depths, strict=True):
            if depth > 1.1 * most and not judged_with_feedback:
                return f"contact {contact.name} is {depth:.3g} m deep, limit {most:g} m"
        if judged_with_feedback:
            return ""
        return self._arrival(path, u, said, nominal) or self._forces(path, t, said)

    def _arrival(self, path: Any, u: np.ndarray, said: dict[str, Any], nominal: np.ndarray) -> str:
        scene = self.scene
        ends = miss(scene, np.concatenate([path.q[-1], path.v[-1]]))
        for what, value, limit in zip(
            ("position", "velocity"), ends, goal_limits(scene), strict=True
        ):
            if value > MISS * limit:
                return f"the true {what} ends {value:.3g} from the goal, limit {limit:g}"
        limit = scene.limit("replay_cost")
        if limit is not None and limit.value is not None:
            whole = cost(scene, path, u)
            if whole > limit.value + abs(limit.value) and whole > 0:
                return f"it costs {whole:.4g}, limit {limit.value:g}"
        if "q" in said:
            stated = scene.limit("replay_error")
            allowed = (
                1e-2 * nominal
                if stated is None or stated.value is None
                else np.maximum(stated.value, 1e-2 * nominal)
            )
            off = np.abs(said["q"] - path.q) / (OFF * (allowed + said["quantum"]))
            if (off > 1.0).any():
                return f"its positions are {off.max():.3g} times five limits off the true ones"
        if "v" in said:
            fastest = np.maximum(np.abs(path.v).max(axis=0), nominal / scene.task.horizon)
            off = np.abs(said["v"] - path.v) / (fastest + OFF * said["quantum"])
            if (off > 0.5).any():
                return f"its velocities are {off.max():.3g} of the largest true one off"
        return ""

    def _forces(self, path: Any, t: np.ndarray, said: dict[str, Any]) -> str:
        """Contact forces against the range of the true ones over each step and its neighbours: the impulse outside, and the whole of it."""
        if "lam" not in said:
            return ""
        spans, force = np.diff(t)[:, None], np.vstack([path.lam_start, path.lam_end[-1:]])
        here = np.stack([path.lam_start, path.lam_end, path.lam_mean])
        low, high = here.min(axis=0), here.max(axis=0)
        highest, lowest = _with_neighbours(high).max(axis=0), _with_neighbours(low).min(axis=0)
        outside = np.maximum(said["lam"] - highest, 0.0) + np.maximum(lowest - said["lam"], 0.0)
        claimed, true = (
            float((np.abs(said["lam"]) * spans).sum()),
            float((path.lam_mean * spans).sum()),
        )
        slack = OFF * (said["quantum"] * float(spans.sum()) + 0.01 * max(claimed, true))
        whole = np.abs(((said["lam"] - path.lam_mean) * spans).sum(axis=0))
        if float((outside * spans).sum()) > 5.0 * slack and whole.max() > slack:
            return f"its contact impulse is {whole.max():.3g} N s off the true {true:.3g} N s"
        peak = max(float(force.max()), 1e-3)
        if said["lam"].min() < -0.05 * peak - OFF * said["quantum"]:
            return f"a contact pulls by {-said['lam'].min():.3g} N"
        return ""


def _columns(text: str, scene: Scene) -> dict[str, Any]:
    """The columns of a plan as anybody would read them, and the half unit of its coarsest column's last decimal."""
    lines = text.splitlines()
    declared = dict(line[1:].split(":", 1) for line in lines if line.startswith("#"))
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    header, body = rows[0], rows[1:]
    places = {name: place for place, name in enumerate(header)}

    def numbers(name: str, last: bool) -> list[float]:
        return [float(row[places[name]]) for row in (body if last else body[:-1])]

    t = np.array(numbers("t", True))
    steps = len(t) - 1
    whole = all(row for row in body[-1]) and scene.coordinates[0].name not in places
    if whole and abs(t[-1] - t[0] - scene.task.horizon) > scene.task.step / 2:
        t, steps = np.append(t, 2 * t[-1] - t[-2]), steps + 1
    u_rows = np.array(
        [
            [float(row[places[item.name]]) for item in scene.inputs]
            for row in body
            if row[places[scene.inputs[0].name]]
        ]
    )
    said: dict[str, Any] = {
        "t": t,
        "u": u_rows[:steps],
        "hold": declared.get(" hold", declared.get("hold", "zero")).strip(),
    }
    said["u_end"] = u_rows[steps] if len(u_rows) > steps else u_rows[-1]
    for key, names in (
        ("q", [item.name for item in scene.coordinates]),
        ("v", [item.velocity_name for item in scene.coordinates]),
        ("lam", [item.force_name for item in scene.contacts]),
    ):  # fmt: skip
        if names and names[0] in places:
            said[key] = np.column_stack([numbers(name, key != "lam") for name in names])
    decimals = [
        len(cell.partition(".")[2]) for row in body for cell in row[1:] if cell and "e" not in cell
    ]
    said["quantum"] = 0.5 * 10.0 ** -max(decimals, default=17)
    return said


@cache
def _parents(reference: str) -> tuple[tuple[str, Plan], ...]:
    """A method's good plan and the exact motion of its inputs, and a relaxed plan."""
    scene, made = scene_of(reference), []
    try:
        good = found(reference, GOOD.get(reference, "strict"))[-1]
        made.append(("a good plan", as_plan(good, scene)))
        path = motion_of(reference).run(good.t, good.u)
        if path.ended:
            made.append(("its exact motion", exact(path, np.array(good.t), np.array(good.u))))
    except NoPlanError:
        pass
    try:
        relaxed = found(reference, RELAXED.get(reference, "softplus_dc+strict"))
        made += [
            ("a relaxed plan", as_plan(relaxed[0], scene)),
            ("a less relaxed plan", as_plan(relaxed[min(2, len(relaxed) - 1)], scene)),
        ]
    except NoPlanError:
        pass
    if not made:
        raise NoPlanError(f"nothing is found to begin with on {reference}")
    return tuple(made)


def run(scenes: list[str], tries: int, seed: int, finds: Path) -> dict[str, Any]:
    """Tries that many wrong plans on each scene and tells of them.

    finds: where those that the judge lets pass are written.
    """
    total, causes, passed = Counter(), Counter(), []
    for number, reference in enumerate(scenes):
        random, began = np.random.default_rng([seed, number]), time.perf_counter()
        oracle, kept, count = Oracle(reference), [], Counter()
        try:
            parents = _parents(reference)
        except NoPlanError as error:
            print(f"search {reference}: skipped, {error}")
            continue
        for _ in range(PATIENCE * tries):
            if count["wrong"] >= tries:
                break
            if kept and random.random() < 0.5:
                parent = min(
                    (kept[index] for index in random.integers(len(kept), size=3)),
                    key=lambda item: item.fails,
                )
                plan, made = mutate(parent.plan, parent.made, scene_of(reference), random)
            else:
                words, first = parents[random.integers(len(parents))]
                plan, made = first, (words,)
                for _ in range(random.integers(1, 4)):
                    plan, made = mutate(plan, made, scene_of(reference), random)
            tried = _tried(reference, plan, made, oracle, finds)
            count["tried"] += 1
            if not tried.wrong and tried.said.verdict != BROKEN:
                continue
            if tried.wrong:
                count["wrong"] += 1
                causes[" ".join(tried.wrong.split(" ")[:2])] += 1
            if tried.said.verdict in (HOLDS, WITH_FEEDBACK, BROKEN):
                count["no answer" if tried.said.verdict == BROKEN else "said to hold"] += 1
                finds.mkdir(parents=True, exist_ok=True)
                path = plan.write(
                    finds / f"{reference}-{seed}-{count['tried']}.csv", scene_of(reference)
                )
                said = {"said": tried.said.verdict, "why": tried.said.why}
                passed.append(
                    {
                        "scene": reference,
                        "plan": str(path),
                        "made": list(made),
                        "wrong": tried.wrong,
                        **said,
                    }
                )
                told = f"{reference}: {' > '.join(made)}: {tried.wrong}; the judge: {tried.said.verdict}, {tried.said.why}"
                print(f"!! find      {told}", flush=True)
            if tried.said.verdict != BROKEN:
                kept.append(tried)
        total += count
        told = ", ".join(
            f"{count[key]} {key}" for key in ("tried", "wrong", "said to hold", "no answer")
        )
        print(f"search {reference}: {told}; {time.perf_counter() - began:.0f} s", flush=True)
    told = f"{total['wrong']} truly wrong, {total['said to hold']} of them said to hold, {total['no answer']} not answered"
    print(f"search: {total['tried']} plans tried on {len(scenes)} scenes, {told}")
    counts = {
        "tried": "tried",
        "wrong": "wrong",
        "said_to_hold": "said to hold",
        "not_answered": "no answer",
    }
    return {
        **{name: total[what] for name, what in counts.items()},
        "causes": dict(causes),
        "finds": passed,
    }


def _tried(reference: str, plan: Plan, made: tuple[str, ...], oracle: Oracle, folder: Path) -> Try:
    scene = scene_of(reference)
    wrong = oracle.wrong(plan.text(scene))
    if not wrong:
        return Try(plan=plan, made=made, wrong="", said=Said(verdict="", why=""), fails=0)
    folder.mkdir(parents=True, exist_ok=True)
    path = plan.write(folder / f"{reference}-last.csv", scene)
    said = judged_in_time(scene, path)
    path.unlink()
    if said.verdict == WITH_FEEDBACK:
        wrong = oracle.wrong(plan.text(scene), judged_with_feedback=True)
    return Try(plan=plan, made=made, wrong=wrong, said=said, fails=said.fails)


def _with_neighbours(rows: np.ndarray) -> np.ndarray:
    """(3, steps, nc) each step, the one before and the one after; round the ends."""
    return np.stack([rows, np.roll(rows, 1, axis=0), np.roll(rows, -1, axis=0)])
