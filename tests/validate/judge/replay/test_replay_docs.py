"""docs/replay.md: its snippets write plans that replay reads, its map fits the foreign FMU."""

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest
from foreign_fmu import build_foreign

from validate.judge.judgement import wire_fmu
from validate.judge.replay.run import replay_foreign

DOCS = Path(__file__).parents[4] / "docs"
TEXT = (DOCS / "replay.md").read_text(encoding="utf-8")
PLANS = dict(re.findall(r"<!-- plan: (\w+) -->\n```python\n(.*?)```", TEXT, flags=re.DOTALL))
MAP = (DOCS / "replay" / "map.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_foreign(tmp_path_factory.mktemp("docs") / "cart.fmu")


@pytest.mark.parametrize("library", ["pandas"])
def test_a_snippet_writes_a_plan_that_is_replayed(
    library: str, fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"{library} is not installed")
    monkeypatch.chdir(tmp_path)
    exec(compile(PLANS[library], f"docs/replay.md ({library})", "exec"), {})
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    wired = wire_fmu(fmu, tmp_path / "plan.csv", map_path=tmp_path / "map.toml")
    assert (wired.plan.steps, wired.plan.missing) == (100, {"lam"})
    result = replay_foreign(wired.foreign, wired.package, wired.plan, limits=wired.limits)
    assert result.ok, result.message
    assert result.q[0, 0] == pytest.approx(0.3)
    assert len(result.events) >= 2  # 4 N push it into the stop


def test_the_map_names_every_section():
    from validate.judge.replay.map_schema import MapFile

    sections = set(tomllib.loads(MAP))
    assert sections | {"internal_step"} == set(MapFile.model_fields)
    assert "internal_step" in TEXT
