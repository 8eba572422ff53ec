"""A few hostile files for every reader: each is read or refused in a sentence."""

from collections import Counter
from pathlib import Path
from random import Random

import pytest
from hostile_inputs import READERS, Reader, tried
from hostile_records import KEY, resume, spoilt_folder
from hypothesis import given, settings
from hypothesis import strategies as st

EACH = 40
# Seeds that ended in a traceback before they were mended: a name of no letters in a zip, a deflated
# entry that is damaged, an encoding that nobody knows; a key of a campaign that is no file name.
MENDED = {"FMU": (16, 35, 42, 56, 915), "record JSON": (1305,)}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_a_hostile_file_is_read_or_refused(name: str, tmp_path: Path):
    outcomes: Counter[str] = Counter()

    @settings(max_examples=EACH)
    @given(st.randoms(note_method_calls=True))
    def is_read_or_refused(rng: Random) -> None:
        outcome = tried(READERS[name], rng, tmp_path)
        outcomes[outcome] += 1
        assert outcome in ("read", "refused"), outcome

    is_read_or_refused()
    assert outcomes["refused"] > EACH / 4, "most mutations do harm, or nothing was tried"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name, seeds in MENDED.items() for seed in seeds]
)
def test_what_was_mended_stays_so(name: str, seed: int, tmp_path: Path):
    assert tried(READERS[name], Random(seed), tmp_path) in ("read", "refused")


def test_a_fault_is_found(tmp_path: Path):
    """The judge of this file itself."""

    def fault(path: Path) -> None:
        raise KeyError(path.name)

    assert "KeyError" in tried(Reader(READERS["plan CSV"].make, fault), Random(1), tmp_path)


def test_a_damaged_netcdf_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    from models.errors import TrajectoryError
    from models.netcdf import read_columns

    (tmp_path / "x.nc").write_bytes(b"no NetCDF at all")
    with pytest.raises(TrajectoryError, match="cannot be read as NetCDF-4"):
        read_columns(tmp_path / "x.nc")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["campaign.json", "record.json", "task.json", "files.json"])
def test_a_file_nested_without_end_is_read_or_refused(name: str, tmp_path: Path):
    """Random mutations seldom put it where a value stands."""

    def nested(rng: Random, folder: Path) -> Path:
        path = spoilt_folder(rng, folder)
        (path if name == "campaign.json" else path / "runs" / KEY).joinpath(name).write_text(
            "[" * 3000, encoding="utf-8"
        )
        return path

    assert tried(Reader(nested, resume), Random(1), tmp_path) in ("read", "refused")
