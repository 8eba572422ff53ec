"""A cell is run again when a module changes that its scene's file imports from beside it, in whatever folder the campaign is started."""

from pathlib import Path

import pytest
from killed_campaigns import FAKES_FOLDER

from validate.cli.narrator import PlainNarrator
from validate.execution.campaign import CampaignSettings, run_campaign
from validate.plan.runs import select, with_stored
from validate.store.store import Store

SCENE = """
import sympy as sp
from dataclasses import replace
from models.catalog import load_scene
from parts_ import Soft, START

scene = load_scene("three_cart")
SCENE = replace(scene, name="own", potential_energy=Soft(scene.coordinates[0].symbol), task=replace(scene.task, start=START))
"""
PARTS = """
import sympy as sp
START = (0.0, 1.0, 2.0, 0.0, 0.0, 0.0)

class Soft(sp.Function):
    def fdiff(self, argindex=1):
        return {stiffness} * self.args[0]

    def _ccode(self, printer):
        return f"({stiffness} * pow({{printer._print(self.args[0])}}, 2) / 2)"

    def _eval_evalf(self, prec):
        return ({stiffness} * self.args[0] ** 2 / 2).evalf()
"""


@pytest.mark.slow
def test_a_changed_module_is_noticed_and_the_old_one_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    monkeypatch.chdir(tmp_path)
    scene, parts, out = tmp_path / "scenes" / "own.py", tmp_path / "scenes" / "parts_.py", tmp_path / "out"
    scene.parent.mkdir()
    scene.write_text(SCENE)

    def settings(stiffness: float) -> CampaignSettings:
        parts.write_text(PARTS.format(stiffness=stiffness))
        return CampaignSettings(out=out, plugin="campaign_fakes:PLUGIN", scenes=("scenes/own.py",), expression="=only_good")

    (first,) = run_campaign(settings(1.0), PlainNarrator()).records
    assert first.outcome == "solved", first.log_tail
    (harder,) = run_campaign(settings(2.0), PlainNarrator()).records  # of which the expressions of the scene say nothing
    assert first.key != harder.key
    assert len(list((out / "runs").iterdir())) == 2
    (back,) = with_stored(select(settings(1.0))[0], Store(out), settings(1.0))
    assert back.stored == first
