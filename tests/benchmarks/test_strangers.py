"""`strangers`: scenes are the same for a seed, their goals are reached, and every family can be loaded."""

import numpy as np
import pytest

from benchmarks.strangers.draw import Simulation, stranger
from benchmarks.strangers.families import FAMILIES
from models.scene.goal import goal_state, miss
from models.scene.text import scene_text

NUMBERS = range(len(FAMILIES))


def test_stranger_same_seed_same_scene():
    first, again, other = stranger(7, 3), stranger(7, 3), stranger(8, 3)
    assert scene_text(first.scene) == scene_text(again.scene)
    assert np.array_equal(first.witness, again.witness)
    assert first.size != other.size


@pytest.mark.parametrize("number", NUMBERS, ids=list(FAMILIES))
def test_stranger_witness_reaches_goal(number: int):
    drawn = stranger(11, number)
    motion = Simulation(drawn.scene, drawn.size).run(drawn.witness)
    assert motion is not None
    missed = miss(np.concatenate([motion.q[-1], motion.v[-1]]), goal_state(drawn.scene.task))
    for part, values in zip(("position", "velocity"), np.split(missed, 2), strict=True):
        limit = drawn.scene.limit(f"terminal_{part}_error")
        assert limit is None or np.linalg.norm(values) <= limit.value
    assert drawn.family == list(FAMILIES)[number]
