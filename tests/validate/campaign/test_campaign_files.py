"""Campaign files: every mistake told with its place, changes and sweeps in the keys, the resolved file runs again to the same cells."""

import json
from pathlib import Path

import pytest
from wording import unsaid

from models.catalog import load_scene
from validate.campaign.read import GIVEN, RESOLVED, ConfigError, read_campaign
from validate.campaign.runs import CampaignSettings, select
from validate.campaign.schema import CampaignFile
from validate.tasks.task import Variant, state_names, varied

EXAMPLES = sorted((Path(__file__).parents[3] / "docs" / "campaigns").glob("*.toml"))

WRONG = """
titel = "x"
time_limit = -3
pipelines = ["strct", "mine", "strict", "strict"]
[[scenes]]
scene = "three_kart"
[[scenes]]
scene = "three_cart"
parameters = { kk = 3, d = -1, c = ["a"] }
start = { q9 = 1 }
goal = { q1 = "fre" }
steps = 0
limits = { replay_eror = 0.1, defect = { valu = 3 } }
[pipeline.mine]
[[pipeline.mine.legs]]
method = "softplus_d"
[[pipeline.mine.legs]]
method = "softplus_dc"
options = { max_iteration = 3, max_iterations = 1e9 }
[[pipeline.mine.legs]]
method = "strict_lcp"
eps = [1e-3]
stage_options = [{}, {}]
"""
# Where each mistake of it is, and what is said there.
TOLD = {
    "titel": "did you mean title?", "time_limit": "it is -3, but must be above 0",
    "pipelines[0]": "did you mean strict?", "pipelines[3]": "stands there twice",
    "scenes[0].scene": "did you mean three_cart?", "scenes[1].parameters.kk": "did you mean k?",
    "scenes[1].parameters.d": "-1 m lies outside its range",
    "scenes[1].parameters.c[0]": "it is 'a', but must be a number",
    "scenes[1].start.q9": "there are q1, q2, q3, v1, v2, v3.",
    "scenes[1].goal.q1[0]": 'a number, or "free"',
    "scenes[1].steps[0]": "it is 0, but must be at least 1",
    "scenes[1].limits.defect.value": "it is missing",
    "scenes[1].limits.defect.valu": "did you mean value?",
    "pipeline.mine.legs[0].method": "did you mean softplus_gd?",
    "pipeline.mine.legs[1].eps": "needs a schedule",
    "pipeline.mine.legs[1].options.max_iteration": "did you mean max_iterations?",
    "pipeline.mine.legs[1].options.max_iterations": "must be a whole number",
    "pipeline.mine.legs[2].eps[0]": "takes no eps",
    "pipeline.mine.legs[2].stage_options": "for 2 stages, but there is 1",
}  # fmt: skip


def written(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


def read(folder: Path, text: str) -> CampaignSettings:
    return read_campaign(written(folder, text))


def keys(campaign: CampaignSettings) -> dict[str, str]:
    entries, _ = select(campaign)
    return {entry.task.title: entry.task.key for entry in entries}


def test_a_file_may_ask_for_what_runs_unasked_on_another_scene_only(tmp_path: Path):
    asked = 'pipelines = ["softplus_gd+strict"]\nchecks = false\n[[scenes]]\nscene = "hopper"\n'
    assert list(keys(read(tmp_path, asked))) == ["hopper x softplus_gd+strict"]


def test_every_mistake_is_told_at_once_with_its_place(tmp_path):
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, WRONG)
    told = dict(mistake.split(": ", 1) for mistake in caught.value.mistakes)
    assert set(told) == set(TOLD)
    assert [place for place in TOLD if TOLD[place] not in told[place]] == []


def test_on_the_command_line_each_is_a_line_and_the_exit_code_is_2(cli, tmp_path):
    done = cli("run", str(written(tmp_path, WRONG)))
    assert (done.returncode, done.stdout) == (2, "")
    first, *lines = done.stderr.splitlines()
    assert first.startswith("error: campaign ")
    assert f"{len(TOLD)} mistakes" in first
    assert len(lines) == len(TOLD)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scenes = []", "scenes: there is none"),
        ("", "scenes: there is none"),
        ("scenes = [3]", "scenes[0]"),
        ('scenes = ["own/scene.py"]', "there is no such file"),
        ('scenes = ["three_cart", "three_cart"]', "2 of them are called 'three_cart'"),
        ('scenes = [{ scene = "three_cart", name = "hopper", steps = 3 }]', "is a scene of ours"),
        ('scenes = [{ scene = "three_cart", name = "../x" }]', "scenes[0].name"),
        (
            'scenes = [{ scene = "three_cart", steps = [1, 2, 3], step = [0.1, 0.2], sweep = "together" }]',
            "but theirs are 3, 2",
        ),
        (
            'scenes = [{ scene = "three_cart", parameters = { k = 1e400 } }]',
            "scenes[0].parameters.k[0]",
        ),
        (
            'scenes = [{ scene = "three_cart", parameters = { k = true } }]',
            "it is True, but must be a number",
        ),
        (
            'scenes = ["three_cart"]\n[pipeline.strict]\nlegs = [{ method = "strict_lcp" }]',
            "it is a pipeline of ours",
        ),
        (
            'scenes = ["three_cart"]\n[pipeline.x]\nlegs = [{ method = "mpcc", options = { search = { a = 1 } } }]',
            "but must be true, false, a number",
        ),
    ],
)
def test_a_mistake_is_one_sentence(tmp_path, text, words):
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text)
    assert not unsaid(caught.value, words)
    assert "\n" not in str(caught.value)


def test_a_sweep_too_large_to_run_is_counted_not_made(tmp_path):
    values = ", ".join(str(value) for value in range(1, 1001))
    lists = f"parameters = {{ k = [{values}], c = [{values}], m = [{values}] }}"
    with pytest.raises(ConfigError, match="give 1000000000 scenes"):
        read(tmp_path, f'[[scenes]]\nscene = "three_cart"\n{lists}')


def test_a_sweep_gives_a_scene_for_each_value():
    scene = load_scene("three_cart")
    changed = varied(
        scene,
        Variant(
            name="other",
            parameters={"k": 300.0},
            steps=7,
            step=0.02,
            start={"q1": 2.1},
            goal={"q1": None, "v2": 0.5},
        ),
    )
    assert changed.parameter_values == {
        **scene.parameter_values,
        next(p.symbol for p in scene.parameters if p.name == "k"): 300.0,
    }
    assert (changed.task.steps, changed.task.step) == (7, 0.02)
    state = dict(
        zip(
            state_names(scene), zip(changed.task.start, changed.task.goal, strict=True), strict=True
        )
    )
    assert state["q1"] == (2.1, None)
    assert state["v2"] == (0.0, 0.5)
    assert state["q3"] == (4.0, 4.5)
    assert changed.title.endswith(
        "; k = 300 N/m, start q1 = 2.1, goal q1 free, goal v2 = 0.5, 7 steps, h = 0.02 s"
    )
    assert scene.answers
    assert not changed.answers, "closed forms and best known costs are those of the unchanged scene"


def test_product_and_together(tmp_path):
    entry = 'scene = "three_cart"\nparameters = { k = [10, 20], c = [1, 3] }\nsteps = 5\n'
    names = [reference.scene.name for reference in read(tmp_path, f"[[scenes]]\n{entry}").chosen]
    assert names == [f"three_cart_k_{k}_c_{c}_steps_5" for k in (10, 20) for c in (1, 3)]
    together = read(tmp_path, f'[[scenes]]\n{entry}name = "mine"\nsweep = "together"')
    assert [reference.scene.name for reference in together.chosen] == [
        "mine_k_10_c_1",
        "mine_k_20_c_3",
    ]
    assert {reference.scene.task.steps for reference in together.chosen} == {5}


CHANGED = [
    "parameters = { k = 31 }", "parameters = { k = 30.000000001 }", "steps = 40", "step = 0.02",
    "start = { q1 = 2.25 }", 'goal = { q1 = "free" }',
    "limits = { replay_error = 0.5 }",
    'limits = { replay_error = { value = 0.5, reason = "another" } }',
]  # fmt: skip


def test_whatever_is_changed_is_part_of_the_key(tmp_path):
    """One name throughout, so that nothing but the change tells the cells apart."""
    found = []
    for change in ["", *CHANGED]:
        text = f'pipelines = ["strict"]\n[[scenes]]\nscene = "three_cart"\nname = "same"\n{change}'
        found += keys(read(tmp_path, text)).values()
    assert len(found) == len(set(found)) == len(CHANGED) + 1


def test_options_and_schedules_are_part_of_the_key(tmp_path):
    legs = [
        "eps = [1e-2]",
        "eps = [1e-3]",
        "eps = [1e-3, 1e-3]",
        "eps = [1e-3]\noptions = { max_iterations = 7 }",
    ]
    legs.append("eps = [1e-3]\nstage_options = [{ max_iterations = 8 }]")
    found = set()
    for leg in legs:
        text = f'scenes = ["three_cart"]\n[pipeline.mine]\n[[pipeline.mine.legs]]\nmethod = "softplus_dc"\n{leg}'
        found |= set(keys(read(tmp_path, text)).values())
    assert len(found) == len(legs)


def test_what_is_not_changed_has_the_key_that_all_gives_it(tmp_path):
    entries, _ = select(
        CampaignSettings(out=tmp_path, scenes=("three_cart",), expression='="strict"')
    )
    assert keys(read(tmp_path, 'scenes = ["three_cart"]\npipelines = ["strict"]')) == {
        "three_cart x strict": entries[0].task.key
    }


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_resolved_file_gives_the_same_cells(path: Path, tmp_path):
    campaign = read_campaign(path)
    resolved = campaign.files[RESOLVED]
    again = read(tmp_path, resolved)
    assert keys(again) == keys(campaign)
    assert again.files[RESOLVED].splitlines()[1:] == resolved.splitlines()[1:], (
        "nothing is left to be filled in"
    )


def test_scene_files_are_looked_up_from_the_campaign_file(tmp_path, monkeypatch):
    source = Path(__file__).parents[2] / "scenes" / "oscillator.py"
    (tmp_path / "below").mkdir()
    (tmp_path / "oscillator.py").write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.chdir(tmp_path / "below")
    (reference,) = read(tmp_path, 'scenes = ["oscillator.py"]').chosen
    assert reference.where == str(tmp_path / "oscillator.py")


@pytest.mark.slow
def test_what_is_stored_is_used_again_and_what_is_changed_is_not(cli, dry_run, tmp_path):
    """In the children too: the record is of the changed scene."""
    fakes = ("--plugin", "campaign_fakes:PLUGIN", "--out", str(tmp_path / "out"))
    text = 'title = "Mine"\npipelines = ["only_good"]\n[[scenes]]\nscene = "three_cart"\nparameters = { k = [30, 300] }\nstart = { q1 = 2.25 }\n'
    path = written(tmp_path, text)
    first = cli("run", str(path), *fakes)
    assert first.returncode == 0, first.stderr
    assert first.stderr.splitlines()[0] == "0 stored, 2 to run"
    assert (tmp_path / "out" / "campaign.toml").read_text() == text
    assert json.loads((tmp_path / "out" / "campaign.json").read_text())["title"] == "Mine"
    scenes = [
        json.loads(record.read_text())["scene"]
        for record in tmp_path.glob("out/runs/*/record.json")
    ]
    stiffness = {
        scene["name"]: next(p["value"] for p in scene["parameters"] if p["name"] == "k")
        for scene in scenes
    }
    assert stiffness == {
        "three_cart_k_30_start_q1_2p25": 30.0,
        "three_cart_k_300_start_q1_2p25": 300.0,
    }
    assert {scene["start"][0] for scene in scenes} == {2.25}
    resolved = dry_run("run", str(tmp_path / "out" / "resolved.toml"), *fakes)
    assert resolved.stdout.splitlines()[-1] == "2 stored, 0 to run"
    written(tmp_path, text.replace("[30, 300]", "[30, 301]"))
    assert (
        dry_run("run", str(path), *fakes)
        .stdout.splitlines()[-1]
        .startswith("1 stored, 1 to run; none of these ran into this folder before")
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("stiffness", "=three_cart_k_120_steps_250"),
        ("schedules", '="in one leap"'),
    ],
)
def test_a_cell_of_each_example_runs(cli, tmp_path, name, words):
    path = next(path for path in EXAMPLES if path.stem == name)
    done = cli("run", str(path), "-k", words, "--json", "--no-worlds", "--out", str(tmp_path))
    assert "1 to run" in done.stderr
    rows = json.loads(done.stdout)["results"]
    assert {row["outcome"] for row in rows} <= {
        "solved",
        "iteration_limit",
        "stalled",
        "local_minimum",
    }
    assert all(row["cost"] > 0 for row in rows)
    if name == "stiffness":
        assert rows[-1]["verdict"] == "holds"


def test_the_schema_has_every_key():
    schema = CampaignFile.model_json_schema()
    assert set(schema["properties"]) == set(CampaignFile.model_fields)
    assert [
        kind["type"]
        for kind in schema["$defs"]["SceneEntry"]["properties"]["parameters"][
            "additionalProperties"
        ]["anyOf"]
    ] == [
        "number",
        "array",
    ]


def test_a_file_from_an_editor_that_begins_with_a_mark_is_read(tmp_path):
    text = 'title = "Mine"\n[[scenes]]\nscene = "three_cart"\n'
    (tmp_path / "plain.toml").write_text(text, encoding="utf-8")
    (tmp_path / "marked.toml").write_text(text, encoding="utf-8-sig")
    plain, marked = (read_campaign(tmp_path / name) for name in ("plain.toml", "marked.toml"))
    for campaign in (plain, marked):
        assert (campaign.title, campaign.chosen, campaign.files[GIVEN]) == (
            "Mine",
            plain.chosen,
            text,
        )
