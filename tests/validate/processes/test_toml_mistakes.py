"""Every key of a campaign file and of a map, with values of every wrong kind: what is told is in our words, never in pydantic's."""

import re
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.trajectory import Trajectory, uniform_grid, write_csv
from validate.campaign import schema
from validate.campaign.read import ConfigError, read_campaign
from validate.campaign.schema import CampaignFile
from validate.judge.replay import map_schema
from validate.judge.replay.map_schema import MapError, MapFile, read_map
from validate.processes.toml_text import TomlError, read_toml, toml_text, toml_value

LIMIT = {"value": 0.5, "reason": "r"}
LEG = {
    "method": "softplus_dc",
    "eps": [1e-3],
    "options": {"max_iterations": 5},
    "stage_options": [{"max_iterations": 5}],
}
SCENE = {
    "scene": "three_cart", "name": "own", "parameters": {"k": [300]}, "steps": [7], "step": [0.01],
    "start": {"q1": [2.0]}, "goal": {"q1": ["free"]},
    "limits": {"replay_error": LIMIT}, "sweep": "product",
}  # fmt: skip
PLANS = {
    "scene": "three_cart", "name": "theirs", "instances": "instances.csv", "plans": "{name}.csv",
    "model": "three_cart", "time_step": "step.py:step", "start": "a.csv",
    "limits": {"replay_error": LIMIT},
}  # fmt: skip
CAMPAIGN = {
    "title": "t", "scenes": [SCENE], "plans": [PLANS], "pipelines": ["own"],
    "pipeline": {"own": {"title": "t", "legs": [LEG]}}, "time_limit": 5.0,
    "checks": False,
}  # fmt: skip
SIGNAL = {"variable": "a", "scale": 1.0, "offset": 0.0, "unit": "N"}
MAP = {
    "plan": {"time": "t", "hold": "zero"}, "task": {"duration": 1.0},
    "inputs": {"F": {**SIGNAL, "lower": -1.0, "upper": 1.0}}, "positions": {"x": SIGNAL},
    "velocities": {"x": {**SIGNAL, "column": "w"}}, "start": {"b": 1.0}, "parameters": {"c": 1.0},
    "uncertainty": {"c": LIMIT}, "goal": {"x": 1.0},
    "contacts": {"stop": {"force": SIGNAL, "gap": SIGNAL, "column": "l", "depth": 0.1, "nominal_force": 5.0,
                          "depth_reason": "d"}}, "internal_step": "h",
    "limits": {"replay_error": {**LIMIT, "waived": False}},
    "accuracy": {"position": 1.0, "velocity": 1.0, "gap": 1.0},
}  # fmt: skip
WRONG = (
    True, 3, 0, -1, 1.5, -2.5, float("nan"), float("inf"), 10**400, 10**20, "", "x", "a b" * 99, [],
    [[]], [{}], [True], ["x"], [-1], [1.5], [0] * 1001,
    {}, {"no_such_key": 1}, {"value": "x"}, {"x": []}, date(2024, 1, 1),
)  # fmt: skip
# How pydantic speaks: "Input should be a valid number", "Extra inputs are not permitted", "Field
# required", "[type=..".
PYDANTIC = re.compile(
    r"\binput\b|should|\bvalid\b|field required|value error|instance of|type=|_type\b|permitted|characters?\b|\bitems?\b",
    re.IGNORECASE,
)


def places(data: Any) -> Iterator[tuple[str | int, ...]]:
    for key, item in (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    ):
        yield (key,)
        yield from ((key, *inside) for inside in places(item))


def changed(data: Any, place: tuple[str | int, ...], value: Any) -> Any:
    first, *rest = place
    copy: Any = dict(data) if isinstance(data, dict) else list(data)
    copy[first] = changed(data[first], tuple(rest), value) if rest else value
    return copy


def write_instance(folder: Path) -> None:
    """Write the files that PLANS names, with one instance."""
    scene = load_scene("three_cart")
    u = np.zeros((scene.task.steps, scene.nu))
    motion = load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
    grid = uniform_grid(scene.task.step, scene.task.steps)
    plan = Trajectory(t=grid, q=motion.q, v=motion.v, u=u, lam=motion.lam)
    (folder / "instances.csv").write_text("name\na\n", encoding="utf-8")
    (folder / "step.py").write_text("def step(q, v, u, h, p):\n    return q, v\n", encoding="utf-8")
    write_csv(folder / "a.csv", plan, scene)


def read_whole(kind: str, path: Path, data: dict[str, Any]) -> None:
    def of(value: Any) -> str:
        return value.isoformat() if isinstance(value, date) else toml_value(value)

    if kind == "campaign":
        write_instance(path.parent)
    path.write_text(
        "\n".join(f"{toml_text(key)} = {of(value)}" for key, value in data.items()) + "\n",
        encoding="utf-8",
    )
    read_campaign(path) if kind == "campaign" else read_map(path)


@pytest.mark.parametrize(
    ("module", "top", "data"), [(schema, CampaignFile, CAMPAIGN), (map_schema, MapFile, MAP)]
)
def test_the_examples_have_every_key(module: Any, top: type[BaseModel], data: dict[str, Any]):
    models = [
        item
        for item in vars(module).values()
        if isinstance(item, type)
        and issubclass(item, BaseModel)
        and item.__module__ == module.__name__
    ]
    keys = {place[-1] for place in places(data)}
    assert top in models
    assert {name for model in models for name in model.model_fields} <= keys


@pytest.mark.parametrize(
    "place",
    [
        (kind, *place)
        for kind, data in (("campaign", CAMPAIGN), ("map", MAP))
        for place in places(data)
    ],
    ids=str,
)
def test_a_value_of_another_kind_is_told_in_our_words(tmp_path: Path, place: tuple[str | int, ...]):
    kind, *inside = place
    data, told = CAMPAIGN if kind == "campaign" else MAP, []
    read_whole(str(kind), tmp_path / "whole.toml", data)
    for wrong in WRONG:
        try:
            read_whole(str(kind), tmp_path / "wrong.toml", changed(data, tuple(inside), wrong))
        except (ConfigError, MapError) as error:
            told.append(str(error).split("wrong.toml", 1)[1])
    assert len(told) > len(WRONG) // 4
    assert [
        text
        for text in told
        if PYDANTIC.search(re.sub(r"'[^']*'", "", text)) or str(inside[0]) not in text
    ] == []


def test_a_file_that_is_no_text_is_answered_without_a_codec(tmp_path: Path):
    file = tmp_path / "robot.toml"
    file.write_bytes(b"PK\x03\x04\x90\xff")
    with pytest.raises(TomlError, match="no text in UTF-8") as caught:
        read_toml(file)
    assert "codec" not in str(caught.value)
