"""A check is left out only where an equal scene of an equal file passed the same check; a note that is damaged or cannot be kept is as none."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from models import checked_once as room
from models.catalog import load_scene
from models.checked_once import checked_once, remembering
from models.errors import SceneError

SCENE = load_scene("two_body_collision")


@pytest.fixture
def checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Whether a scene of a file is looked at; the cache folder is new."""
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path / "cache"))
    seen = []

    def whether(scene=SCENE, file: bytes = b"one") -> bool:
        seen.clear()
        with remembering(file):
            checked_once(scene, seen.append)
        return bool(seen)

    return whether


def test_an_equal_scene_is_checked_once(checked, tmp_path: Path):
    assert checked()
    assert not checked()
    assert not checked(SCENE.with_parameters(k=SCENE.parameter_values[next(p.symbol for p in SCENE.parameters if p.name == "k")]))
    (note,) = (tmp_path / "cache").iterdir()
    assert note.suffix == ".checked"


@given(st.floats(1.0, 1e6), st.integers(2, 500), st.binary(max_size=3))
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_another_number_or_file_is_checked(checked, k: float, steps: int, file: bytes):
    """Against what was checked before, told by the numbers themselves."""
    known = checked.__dict__.setdefault("known", set())
    asked = (k, steps, file)
    assert checked(SCENE.with_parameters(k=k).with_task(steps=steps), file) == (asked not in known)
    known.add(asked)


def test_other_sources_and_versions_are_noticed(checked, monkeypatch: pytest.MonkeyPatch):
    assert checked()
    for where, name, value in (
        (room, "_sources", lambda: "other"),
        (room.sp, "__version__", "99"),
        (room.platform, "python_version", lambda: "9"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(where, name, value)
            assert checked()
    assert not checked()


@pytest.mark.parametrize("damage", [b"", b"\xff\x00", b"0" * 64])
def test_a_damaged_note_is_none(checked, tmp_path: Path, damage: bytes):
    assert checked()
    (note,) = (tmp_path / "cache").iterdir()
    note.write_bytes(damage)
    assert checked()


def test_without_a_cache_folder_all_is_checked(checked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path / "file" / "cache"))
    assert checked()
    assert checked()


def test_outside_of_files_nothing_is_noted(checked, tmp_path: Path):
    seen = []
    checked_once(SCENE, seen.append)
    checked_once(SCENE, seen.append)
    assert len(seen) == 2
    assert not (tmp_path / "cache").exists()


def test_a_scene_that_contradicts_itself_says_so_every_time(checked, tmp_path: Path):
    path = tmp_path / "soft_pair.py"
    path.write_text(
        "from dataclasses import replace\nfrom models.catalog import load_scene\n"
        'SCENE = replace(load_scene("two_body_collision"), name="soft_pair").with_parameters(k=-1.0)\n'
    )
    sentences = []
    for _ in range(2):
        with pytest.raises(SceneError) as caught:
            load_scene(str(path))
        sentences.append(str(caught.value))
    assert sentences[0] == sentences[1]
    path.write_text(path.read_text().replace("k=-1.0", "k=10.0"))
    assert load_scene(str(path)).name == "soft_pair"
