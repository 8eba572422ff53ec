"""How large pages are, on a campaign of 16 scenes by 19 pipelines made by hand."""

import re
from dataclasses import replace
from hashlib import sha256

import pytest

from reports.render import PAGES, write_report

SCENES = 16
PIPELINES = 19
# Bytes: what opens at once over a slow line, and what is read on paper. The page of a scene draws
# every relaxation at each of its eps, about ten plots each of 4 kB, and lists all of its stages: as
# much as report.html. The overview has some 650 links; a page name that says scene and pipeline, here
# of 45 letters, is 18 longer than a digest: 12 kB, of which 10 are added to the 150 of digests.
LARGEST = {"report.html": 600_000, "overview": 160_000, "run": 300_000, "scene": 600_000}


@pytest.fixture(scope="module")
def folder(factory, tmp_path_factory):
    """Each pipeline with three relaxed stages or none, as in Table I, which others share.

    Half of the runs hold; motions of four runs.
    """
    runs = []
    for scene in range(SCENES):
        where = factory.scene("three_cart" if scene == 0 else f"a_scene_of_number_{scene}")
        for place in range(PIPELINES):
            run = factory.run(*factory.PIPELINES[place % len(factory.PIPELINES)])
            verdict = ("holds", "violates", "holds with feedback", "not applicable")[
                (place + scene) % 4
            ]
            why = "driven by its inputs the motion departs from the plan by 0.794 rad, limit 0.2 rad: discretisation error 0.794 rad."
            drawn, options = scene == 0 and place < 4, {"variant": place // len(factory.PIPELINES)}
            stages = [replace(stage, has_plan=drawn, options=options) for stage in run.stages]
            stages[-1] = replace(stages[-1], verdict=verdict, why=why)
            changed = {
                "key": sha256(f"{scene} {place}".encode()).hexdigest(),
                "pipeline": f"{run.pipeline}_{place}", "scene": where, "verdict": verdict,
            }  # fmt: skip
            if verdict == "not applicable":
                stages = []
            message = "strict_lcp: scene has no inputs, so there is nothing to plan."
            runs.append(replace(run, **{**changed, "message": message, "stages": tuple(stages)}))
    return factory.store(tmp_path_factory.mktemp("budget") / "all", runs)


@pytest.mark.slow
def test_pages_keep_their_budget(folder):
    text = write_report(folder).read_text(encoding="utf-8")
    assert text.count('title="') >= SCENES * PIPELINES, "every run is there"
    overview = re.search(r'<section id="overview".*?</section>', text, re.DOTALL)
    assert len(overview[0].encode()) <= LARGEST["overview"]
    assert len(text.encode()) <= LARGEST["report.html"]
    sizes = {
        path.name: path.stat().st_size for path in (folder / PAGES).iterdir() if "--" in path.stem
    }
    assert len(sizes) == SCENES * PIPELINES * 3 // 4, "runs that do not apply have no page"
    assert 50_000 < max(sizes.values()) <= LARGEST["run"]
    scenes = [path.stat().st_size for path in (folder / PAGES).glob("scene-*.html")]
    assert len(scenes) == SCENES
    assert 100_000 < max(scenes) <= LARGEST["scene"]


@pytest.mark.slow
def test_each_tip_stands_once_on_the_first_screen(folder):
    """Hover, the name for assistive technology and the script read the same words."""
    overview = re.search(
        r'<section id="overview".*?</section>',
        write_report(folder).read_text(encoding="utf-8"),
        re.DOTALL,
    )
    tips = re.findall(r"<title>([^<]*)</title>", overview[0])
    assert len(tips) > 200
    for tip in tips[:20]:
        assert overview[0].count(tip) == tips.count(tip)
