"""`-k` reads as pytest's does, and a quick campaign says what it leaves out."""

from pathlib import Path

import pytest
from wording import unsaid

from models.catalog import load_scene, scene_names
from validate.campaign.runs import (
    CampaignSettings,
    NothingSelectedError,
    _scenes,
    scene_cost,
    scenes_of,
    select,
)
from validate.campaign.selection import SelectionError, matches, near, words_of
from validate.tasks.task import CheckTask

NAMES = ("three_cart", "softplus_dc+strict", "softplus_dc", "strict_lcp")


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("strict", True), ("STRICT", True), ("softplus_dc+strict", True), ("relaxed", False),
        ("not relaxed", True), ("strict and relaxed", False),
        ("strict and not relaxed", True), ("relaxed or three", True),
        ("relaxed or gd and strict", False), ("(relaxed or strict) and three", True),
        ("not (relaxed or strict)", False), ("not not strict", True), ("strict or relaxed", True),
        ("relaxed or strict or relaxed", True), ("=strict", False),
        ("=strict_lcp", True), ("=STRICT_LCP and not =strict", True),
        ('="the ""title"" of it"', True), ('="the title"', False), ('="strict_lcp"', True),
        ("title", False), ('="', False),
    ],
)  # fmt: skip
def test_expressions(expression, expected):
    assert matches(expression, NAMES, 'The "title" of it') is expected


def test_the_words_of_an_expression_are_its_names():
    assert words_of('(strict or not =mpcc) and ="a b" and strict') == ["strict", "=mpcc", '="a b"']


@pytest.mark.parametrize(
    ("word", "nearest"),
    [
        ("strikt", "strict_lcp"),
        ("thre_cart", "three_cart"),
        ("=softplus_d", "softplus_dc"),
        ("SOFPLUS", "softplus_dc"),
    ],
)
def test_near_a_misspelt_name_is_the_name(word, nearest):
    assert near(word, ("an FMU of three_cart, FMI 2.0", *NAMES))[0] == nearest


def test_a_part_of_a_name_is_near_too():
    assert near("strickt", ["structure", "softplus_gd+strict"]) == [
        "softplus_gd+strict",
        "structure",
    ]


def test_something_is_near_whatever_was_typed():
    assert len(near("zzz", NAMES)) == 1


def test_of_several_words_those_that_are_in_no_name_are_answered():
    error = NothingSelectedError("strict and sofplus and a1 and a2 and a3", NAMES)
    assert "strict and sofplus" in error.headline
    assert [sentence.partition(" is in no name")[0] for sentence in error.mistakes[:-1]] == [
        "'sofplus'",
        "'a1'",
        "'a2'",
    ]
    assert len(error.mistakes) + 1 == 5, "five lines at most"
    (both, _) = NothingSelectedError("strict and three", NAMES).mistakes
    assert "each of its words is in a name" in both
    (alone, _) = NothingSelectedError("=free_motion", NAMES).mistakes
    assert not unsaid(
        alone, "'=free_motion' is a method that no pipeline … runs; … formulations/pipelines.py"
    )


def test_cheap_scenes_come_first_after_that_of_the_paper(tmp_path: Path):
    scenes = [reference.scene for reference in _scenes(CampaignSettings(out=tmp_path))]
    assert scenes[0].name == "three_cart"
    costs = [scene_cost(scene) for scene in scenes[1:]]
    assert costs == sorted(costs)
    assert [scene.name for scene, cost in zip(scenes[1:], costs, strict=True) if cost == 0] == [
        "bouncing_mass",
        "damped_collision",
        "two_body_collision",
    ]
    assert scene_cost(load_scene("push_box")) == 100 * 2 * 5 * 2, (
        "steps, states, and a contact with friction"
    )
    named = _scenes(CampaignSettings(out=tmp_path, scenes=("two_finger", "three_cart")))
    assert [reference.scene.name for reference in named] == ["two_finger", "three_cart"], (
        "as they were typed"
    )


@pytest.mark.parametrize(
    ("expression", "parts"),
    [
        *((text, ["-k"]) for text in ("", "and", "not", "strict)", "()")),
        ("strict and", ["a name is missing at its end"]),
        ("or strict", ["a name is missing before 'or'"]), ("(strict", ["a ')' is missing"]),
        ("(strict relu", ["a ')' is missing"]),
        ("strict relaxed", ["'relaxed' was not expected"]),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence_that_names_its_place(expression, parts):
    with pytest.raises(SelectionError) as caught:
        matches(expression, NAMES)
    assert all(part in str(caught.value) for part in (repr(expression), *parts))
    assert "\n" not in str(caught.value)


def test_a_quick_campaign_says_once_what_it_leaves_out_of_every_scene(tmp_path) -> None:
    entries, left_out = select(
        CampaignSettings(
            out=tmp_path,
            scenes=("three_cart", "bouncing_mass"),
            quick=True,
            expression="strict or free_motion",
        )
    )
    chosen = [(entry.task.scene_name, entry.task.pipeline.name) for entry in entries]
    quick = "softplus_dc+strict"
    assert chosen == [
        ("three_cart", quick),
        ("bouncing_mass", quick),
        ("bouncing_mass", "free_motion"),
    ]
    assert left_out == (
        "every scene x strict",
        "every scene x relaxed+strict",
        "three_cart x softplus_gd+strict",
    )
    _, of_one = select(
        CampaignSettings(
            out=tmp_path, scenes=("three_cart",), quick=True, expression="softplus and strict"
        )
    )
    assert of_one == ("three_cart x softplus_gd+strict",)


@pytest.mark.slow
def test_a_quick_campaign_leaves_out_the_long_scenes_unless_they_are_named(tmp_path) -> None:
    entries, left_out = select(CampaignSettings(out=tmp_path, quick=True))
    scenes = {name: load_scene(name) for name in scene_names()}
    long = {name for name, scene in scenes.items() if not scene.quick}
    assert long
    assert set(scenes_of(entries)) == set(scenes) - long
    assert {f"{name} x every pipeline" for name in long} <= set(left_out)
    assert not {entry.task.scene for entry in entries if isinstance(entry.task, CheckTask)} & long
    named, _ = select(CampaignSettings(out=tmp_path, quick=True, scenes=(min(long),)))
    assert set(scenes_of(named)) == {min(long)}
    every, _ = select(CampaignSettings(out=tmp_path))
    assert set(scenes_of(every)) == set(scenes)
