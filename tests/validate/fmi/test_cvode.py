"""CVODE by the addresses of its functions: the bits of scikit-sundae's own CVODE, its failures in words, and where it is looked for."""

import ctypes
import math
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sksundae.cvode import CVODE

from models.errors import MachineError
from validate.fmi import cvode
from validate.fmi.cvode import ADAMS, BDF, FILLS, ROOT_RETURN, Cvode, array_of


def filling(function: Any, size: int, in_vector: bool) -> Any:
    """A function of (t, y) that gives `size` numbers, of three states, as CVODE calls it."""

    def fill(time: float, y: int, filled: int, _: None) -> int:
        states = (ctypes.c_double * 3).from_address(array_of(y))
        values = (ctypes.c_double * size).from_address(array_of(filled) if in_vector else filled)
        values[:] = function(time, states)
        return 0

    return FILLS(fill)


def swing(time: float, y: Any) -> list[float]:
    """A damped pendulum, and what falls beside it."""
    return [y[1], -9.81 * math.sin(y[0]) - 0.125 * y[1], -0.5 * y[2] + time]


def zeros(time: float, y: Any) -> list[float]:
    return [y[0], time - 0.75]


def made(method: tuple[int, int], y: np.ndarray, **more: Any) -> Cvode:
    given: dict[str, Any] = {
        "rtol": 1e-8, "absolute": np.array([1e-9, 2e-9, 3e-9]), "min_step": 1e-14, "max_step": 0.25,
        "max_steps": 10_000,
    }  # fmt: skip
    given |= {"rates": filling(swing, 3, True), "indicators": filling(zeros, 2, False), "count": 2}
    return Cvode(method, y, **(given | more))


@pytest.mark.parametrize("method", [ADAMS, BDF], ids=["Adams", "BDF"])
def test_a_model_without_states_is_followed_to_its_events(method: tuple[int, int]):
    """Such a model has outputs and event indicators of time and inputs alone."""

    def still(_time: float, _y: int, filled: int, _: None) -> int:
        (ctypes.c_double * 1).from_address(array_of(filled))[:] = [0.0]
        return 0

    def half(time: float, _y: int, filled: int, _: None) -> int:
        (ctypes.c_double * 1).from_address(filled)[:] = [time - 0.5]
        return 0

    solver = made(
        method,
        np.zeros(0),
        rates=FILLS(still),
        indicators=FILLS(half),
        count=1,
        absolute=np.zeros(0),
    )
    solver.renew(0.0)
    assert solver.advance(1.0, 2.0, one_step=False) == ROOT_RETURN
    assert solver.time == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize(("method", "name"), [(ADAMS, "Adams"), (BDF, "BDF")])
@pytest.mark.parametrize("one_step", [False, True])
def test_it_is_scikit_sundaes_cvode_bit_for_bit(method: tuple[int, int], name: str, one_step: bool):
    start = np.array([1.0, -0.25, 2.0])
    ours = made(method, start.copy())
    ours.renew(0.125)

    def rates(time: float, y: np.ndarray, yp: np.ndarray) -> None:
        yp[:] = swing(time, y)

    def events(time: float, y: np.ndarray, values: np.ndarray) -> None:
        values[:] = zeros(time, y)

    theirs = CVODE(
        rates, method=name, rtol=1e-8, atol=np.array([1e-9, 2e-9, 3e-9]), min_step=1e-14,
        max_step=0.25, max_num_steps=10_000, eventsfn=events, num_events=2
    )  # fmt: skip
    theirs.init_step(0.125, start)
    signs, looks = [], 0
    for target in (0.5, 1.0, 1.5, 2.5):
        while ours.time < target:
            flag = ours.advance(target, target, one_step=one_step)
            result = theirs.step(target, "onestep" if one_step else "normal", target)
            assert (flag, ours.time, ours.y.tolist()) == (
                result.status,
                result.t,
                result.y.tolist(),
            )
            looks += 1
            if flag == ROOT_RETURN:
                assert ours.roots.tolist() == result.i_events[-1].tolist()
                signs.append(ours.roots.tolist())
    assert looks > (50 if one_step else 6)
    assert [0, 1] in signs
    assert [-1, 0] in signs
    assert [1, 0] in signs
    ours.close()
    ours.close()


def test_a_new_solver_goes_on_from_what_was_changed():
    y = np.array([1.0, 0.0, 0.0])
    ours, again = made(BDF, y), made(BDF, np.array([0.5, 0.0, 0.0]))
    ours.renew(0.0)
    ours.advance(0.3, 1.0, one_step=False)
    y[:] = [0.5, 0.0, 0.0]
    ours.renew(0.25)
    again.renew(0.25)
    for solver in (ours, again):
        solver.advance(0.5, 0.5, one_step=False)
    assert (ours.time, y.tolist()) == (0.5, again.y.tolist())
    ours.close()
    again.close()


def test_what_cvode_gives_up_has_its_words():
    few = made(ADAMS, np.array([1.0, 0.0, 0.0]), max_steps=2, rtol=1e-12)
    few.renew(0.0)
    before = few.y.tolist()
    flag = few.advance(1.0, 1.0, one_step=False)
    assert (flag, few.time, few.y.tolist(), cvode.why(flag)) == (
        -1,
        0.0,
        before,
        "Could not reach endpoint after 'max_num_steps'.",
    )
    with pytest.raises(RuntimeError, match=r"refused its stop time at t = 0 s"):
        few.advance(1.0, -1.0, one_step=False)
    few.close()
    failing = Cvode(
        ADAMS,
        np.zeros(1),
        rates=FILLS(lambda *_: -1),
        rtol=1e-6,
        absolute=np.ones(1),
        min_step=0.0,
        max_step=1.0,
        max_steps=9,
    )
    failing.renew(0.0)
    assert "right-hand-side" in cvode.why(failing.advance(1.0, 1.0, one_step=False))
    failing.min_step = 2.0
    with pytest.raises(RuntimeError, match=r"CVODE refused to be set up at t = 0\.5 s"):
        failing.renew(0.5)
    failing.close()
    assert cvode.why(-28) == "CVODE's flag -28."


def test_a_solver_that_is_missing_damaged_or_of_another_version_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for spec in (
        None,
        SimpleNamespace(submodule_search_locations=[str(tmp_path)]),
        SimpleNamespace(submodule_search_locations=None),
    ):
        monkeypatch.setattr(cvode.importlib.util, "find_spec", lambda name, spec=spec: spec)
        with pytest.raises(MachineError, match="CVODE, is missing"):
            cvode.functions.__wrapped__()
    (tmp_path / "_cy_cvode.py").write_text("")
    (tmp_path / "_cy_cvode.x.so").write_bytes(b"nothing")
    monkeypatch.setattr(
        cvode.importlib.util,
        "find_spec",
        lambda name: SimpleNamespace(submodule_search_locations=[str(tmp_path)]),
    )
    with pytest.raises(MachineError, match=r"cannot be reached in .*_cy_cvode\.x\.so \("):
        cvode.functions.__wrapped__()
    monkeypatch.undo()
    assert cvode.address("CVode") != cvode.address("CVodeReInit")
    monkeypatch.setattr(cvode, "_VERSION", 6)
    with pytest.raises(MachineError, match=r"is of SUNDIALS 7 in .*, not 6"):
        cvode.functions.__wrapped__()


def test_it_prints_nothing_and_leaves_no_file_open(capfd: pytest.CaptureFixture[str]):
    """Of an indicator that stays zero SUNDIALS would warn on stderr."""
    solver = made(
        ADAMS,
        np.array([1.0, -0.25, 2.0]),
        indicators=filling(lambda time, y: [0.0, time - 9.0], 2, False),
    )
    solver.renew(0.0)
    open_files = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else 0
    for _ in range(3):
        solver.renew(0.0)
        assert solver.advance(0.5, 1.0, one_step=False) >= 0
    assert not open_files or len(os.listdir("/proc/self/fd")) == open_files
    assert capfd.readouterr() == ("", "")
