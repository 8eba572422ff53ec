"""The default limits and the share of feedback."""

from dataclasses import replace

import numpy as np
import pytest

from models.catalog import load_scene
from models.scene import Limit
from models.scene.default_limits import FEEDBACK_SHARE, limit_of, replay_limits
from models.trajectory import input_share

SCENE = load_scene("three_cart")
OF_GOAL = tuple(limit for limit in SCENE.limits if "terminal" in limit.metric)
BARE = replace(SCENE, limits=OF_GOAL)


def with_limit(metric: str, value: float | None):
    return replace(SCENE, limits=(*OF_GOAL, Limit(metric=metric, value=value, reason="a test")))


def test_limit_of_default_scene_and_waived():
    assert limit_of(BARE, "feedback_share") == FEEDBACK_SHARE
    assert limit_of(BARE, "replay_cost") is None
    assert limit_of(with_limit("feedback_share", 0.7), "feedback_share") == 0.7
    assert limit_of(with_limit("feedback_share", None), "feedback_share") is None


def test_replay_limits_default_is_a_share_of_each_nominal():
    nominals = np.array([item.nominal for item in SCENE.coordinates])
    assert replay_limits(BARE) == pytest.approx(0.01 * nominals)
    assert replay_limits(with_limit("replay_error", 0.3)).tolist() == [0.3] * 3
    assert np.isinf(replay_limits(with_limit("replay_error", None))).all()


def test_input_share_weighs_inputs_by_their_scale():
    t, one = np.linspace(0.0, 2.0, 101), np.ones((100, 1))
    found = input_share(
        t, np.hstack([one, 2 * one]), np.hstack([3 * one, 8 * one]), np.array([1, 2])
    )
    assert found == pytest.approx(np.hypot(1.0, 1.0) / np.hypot(3.0, 4.0))
    assert input_share(t, one, 0 * one, np.ones(1)) is None
    assert input_share(t, 0 * one, 0 * one, np.ones(1)) == 0.0
