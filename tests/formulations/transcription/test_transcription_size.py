"""The model Ipopt is given is as large as on paper, on every scene of the bank; what is counted is told."""

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


@pytest.mark.parametrize("method", ["softplus_dc", "relaxed_lcp", "strict_lcp"])
def test_a_solution_says_how_large_its_model_was(method: str):
    scene = load_scene("wall_pendulum")
    found = load_method(method)
    eps = None if method == "strict_lcp" else 1e-2
    solution = found.open(scene).solve(eps=eps, warm_start=None, time_limit=60.0)
    assert solution.size is not None
    assert solution.size == solution.paper_size
