"""Options and starts that are taken, and those that are refused in a sentence."""

import pathlib

import numpy as np
import pytest

from formulations.ipopt import Start, UnknownOptionError, compile_model, solve
from formulations.ipopt.options import known_options
from formulations.solution import Outcome
from tests.formulations.ipopt.problems import quadratic


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tolerance": 1e-6}, "tol"), ({"max_itr": 5}, "max_iter"), ({"linear_solver": "ma97"}, "mumps"), ({"mehrotra_algorithm": "yes"}, "ends the process"),
        ({"tol": "small"}, "number"), ({"max_iter": 2.5}, "whole number"), ({"max_iter": float("inf")}, "whole number of at most 2147483647"),
        ({"max_iter": 10**12}, "whole number of at most 2147483647"), ({"mu_strategy": "fast"}, "adaptive"), ({"tol": -1.0}, "does not accept"),
        ({"tol": float("nan")}, "number"),
    ],
)  # fmt: skip
def test_options_that_cannot_be_are_refused_in_a_sentence(options, words, capfd):
    with pytest.raises(UnknownOptionError, match=words):
        solve(compile_model(quadratic()), options=options)


def test_options_are_converted_used_and_recorded():
    result = solve(compile_model(quadratic()), options={"tol": "1e-6", "max_iter": 50.0, "mu_strategy": "adaptive", "recalc_y": True})
    assert result.outcome is Outcome.SOLVED
    assert (result.options["tol"], result.options["max_iter"], result.options["recalc_y"]) == (1e-6, 50, "yes")


def test_an_option_file_lying_about_changes_nothing(tmp_path, monkeypatch):
    (tmp_path / "ipopt.opt").write_text("max_iter 0\n")
    monkeypatch.chdir(tmp_path)
    assert pathlib.Path("ipopt.opt").exists()
    assert solve(compile_model(quadratic())).outcome is Outcome.SOLVED


def test_the_list_of_options_is_what_ipopt_knows(capfd):
    """Every name is accepted by the installed Ipopt with some value, so that the list cannot rot."""
    import cyipopt

    from formulations.ipopt.options import _CHOICES, _REALS

    class Parabola:
        def objective(self, x):
            return x[0] ** 2

        def gradient(self, x):
            return 2 * x

    nlp = cyipopt.Problem(1, 0, Parabola(), [0.0], [1.0])
    for name in known_options():
        real = name in _REALS
        tries = _CHOICES.get(name, ("mumps",) if name == "linear_solver" else [0.4, 1.5, 10.0] if real else [1, 0, 5])
        accepted = 0
        for value in tries:
            try:
                nlp.add_option(name, value)
            except TypeError:
                continue
            accepted += 1
        assert accepted == len(tries) if name in _CHOICES else accepted > 0, name


@pytest.mark.parametrize("start", [Start(x=np.zeros(3)), Start(x=np.array([np.nan, 0.0])), Start(x=np.zeros(2), lagrange=np.zeros(5))])
def test_a_start_of_the_wrong_shape_is_refused(start):
    with pytest.raises(ValueError, match="warm_start"):
        solve(compile_model(quadratic()), warm_start=start)


def test_a_time_limit_is_positive():
    with pytest.raises(ValueError, match="time_limit"):
        solve(compile_model(quadratic()), time_limit=0.0)
