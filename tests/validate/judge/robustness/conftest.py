"""The best plan of three carts, judged once."""

import pytest

from formulations.pipelines import solve_scene
from models.catalog import load_scene
from validate.judge.judgement import Judgement, judge


@pytest.fixture(scope="session")
def judged() -> Judgement:
    scene = load_scene("three_cart")
    return judge(scene, solve_scene(scene, "mpcc"))
