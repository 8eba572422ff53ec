"""The model Ipopt is given is as large as on paper, on every scene of the bank; what is counted is told."""

from __future__ import annotations

import pytest

from formulations import build_model
from formulations.ipopt import compile_model
from formulations.pipelines import load_method
from formulations.solution import ModelSize
from formulations.transcription.compiled import size_on_paper
from formulations.transcription.contact import ContactFormulation
from models.catalog import load_scene, scene_names


@pytest.mark.slow
@pytest.mark.parametrize("contact", [ContactFormulation.SOFTPLUS, ContactFormulation.COMPLEMENTARITY])
@pytest.mark.parametrize("name", scene_names())
def test_no_unknown_and_no_equation_too_many(name: str, contact: ContactFormulation):
    for steps in (1, 6):
        scene = load_scene(name).with_task(steps=steps)
        problem = compile_model(build_model(scene, contact, eps=1e-2))
        assert ModelSize(unknowns=problem.n, equations=problem.m) == size_on_paper(scene, contact)


def test_counts_by_hand_of_the_papers_scene():
    """6 states at 501 nodes, 2 inputs and 2 forces a step; 12 ends, 6 + 2 equations a step; complementarity: two more of each a step."""
    scene = load_scene("three_cart")
    assert size_on_paper(scene, ContactFormulation.SOFTPLUS) == ModelSize(unknowns=6 * 501 + 4 * 500, equations=12 + 8 * 500)
    assert size_on_paper(scene, ContactFormulation.COMPLEMENTARITY) == ModelSize(unknowns=6 * 501 + 6 * 500, equations=12 + 10 * 500)


# steps, then a node: states; a step: what softplus has, and what complementarity has more (a contact one, a friction four, of each of both);
# ends: those of the start, and those of the goal that are given.
BY_HAND = {
    # 5 positions, 2 forces on the finger, one contact, one friction; x, y of the box, and the rest of its goal
    "push_box": (100, 10, 2 + 1 + 1, 1 + 4),
    # 5 positions, thrust and hip, floor, its friction
    "hopper_planar": (200, 10, 2 + 1 + 1, 1 + 4),
    # 7 positions, 4 torques, 2 tips
    "two_finger": (500, 14, 4 + 2, 2),
    # the same with a table and the friction of the tips
    "two_finger_lift": (200, 14, 4 + 3 + 2, 3 + 2 * 4),
    # cargo and cart, one force, two stops, one friction
    "transport": (200, 4, 1 + 2 + 1, 2 + 4),
}


@pytest.mark.parametrize("name", BY_HAND)
def test_counts_by_hand_of_scenes_with_friction_and_fingers(name: str):
    steps, states, soft, more = BY_HAND[name]
    scene = load_scene(name)
    goal = sum(value is not None for value in scene.task.goal)
    laws = soft - scene.nu
    assert size_on_paper(scene, ContactFormulation.SOFTPLUS) == ModelSize(
        unknowns=states * (steps + 1) + soft * steps, equations=states + goal + (states + laws) * steps
    )
    assert size_on_paper(scene, ContactFormulation.COMPLEMENTARITY) == ModelSize(
        unknowns=states * (steps + 1) + (soft + more) * steps, equations=states + goal + (states + laws + more) * steps
    )


@pytest.mark.parametrize("method", ["softplus_dc", "relaxed_lcp", "strict_lcp"])
def test_a_solution_says_how_large_its_model_was(method: str):
    scene = load_scene("wall_pendulum")
    found = load_method(method)
    eps = None if method == "strict_lcp" else 1e-2
    solution = found.open(scene).solve(eps=eps, warm_start=None, time_limit=60.0)
    assert solution.size is not None
    assert solution.size == solution.paper_size
