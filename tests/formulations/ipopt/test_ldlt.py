"""Our factorisation, called as Ipopt calls it, against eigenvalues and residuals of numpy.

Who factorises: by default ours where it can be had, else MUMPS; both come to the same optimum; what
is insisted on is told where it is missing.
"""

import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sparse

from formulations import ContactFormulation, build_model
from formulations.ipopt import compile_model, linear_solver, solve
from formulations.ipopt.linear_solver import LINEAR_SOLVERS
from formulations.solution import Outcome
from models.catalog import load_scene
from models.errors import MachineError
from tests.formulations.ipopt.factored import (
    SINGULAR,
    Factor,
    arrow,
    chain,
    dense,
    grid,
    hubs,
    no_diagonal,
    saddle,
    scaled,
    wide_range,
)
from tests.formulations.ipopt.problems import quadratic


@pytest.mark.parametrize("kind", [saddle, no_diagonal, arrow, wide_range, chain, dense, grid, hubs])
@pytest.mark.parametrize("pivot", [1e-8, 1e-4, 0.5])
def test_inertia_and_solution_are_those_of_numpy(kind, pivot: float) -> None:
    checked = 0
    for seed in range(12):
        random = np.random.default_rng(seed)
        matrix = kind(random, int(random.integers(2, 30 if kind is chain else 90)))
        whole = matrix.toarray()
        factor = Factor(matrix, pivot)
        if not np.abs(whole).max(axis=0).all():
            assert factor.info[0] == SINGULAR
            continue
        scale, even = scaled(whole)
        eigenvalues = np.linalg.eigvalsh(even)
        if np.abs(eigenvalues).min() < 1e-9:
            continue
        right = random.normal(size=factor.n)
        x = factor.solve(right / scale)
        error = np.abs(scale * (whole @ x) - right).max() / (
            np.abs(even).max() * np.abs(x / scale).max() + np.abs(right).max()
        )
        assert factor.info[0] == 0
        assert factor.negative == int((eigenvalues < 0.0).sum())
        assert error < 1e-7 if kind is wide_range else error < 1e-10
        checked += 1
    assert checked >= 4


def test_a_pivot_that_must_wait_is_put_off_to_the_parent() -> None:
    # No variable has a diagonal and every neighbour of 0 is taken by a stronger one: pairs alone do
    # not do.
    for seed in range(20):
        random = np.random.default_rng(seed)
        tree = sparse.lil_array((41, 41))
        for i in range(1, 41):
            parent = (i - 1) // 2
            tree[i, parent] = tree[parent, i] = random.normal() * 10.0 ** random.uniform(-5, 0)
        tree[0, 0] = 1.0
        for i in range(21, 41):
            tree[i, i] = 1e-9 * random.normal()
        dense = tree.toarray()
        factor = Factor(sparse.csr_array(tree))
        assert factor.info[0] == 0
        assert factor.negative == int((np.linalg.eigvalsh(scaled(dense)[1]) < 0.0).sum())


@pytest.mark.parametrize("seed", range(8))
def test_dependent_rows_that_are_regularised_as_ipopt_does_have_their_inertia(seed: int) -> None:
    random = np.random.default_rng(seed)
    jacobian = random.normal(size=(5, 9))
    jacobian[3] = 0.3 * jacobian[0] - 7.0 * jacobian[2]
    dense = np.block(
        [[np.diag(random.uniform(0.5, 2.0, 9)), jacobian.T], [jacobian, -1e-8 * np.eye(5)]]
    )
    factor = Factor(sparse.csr_array(dense))
    assert (int(factor.info[0]), factor.negative) == (0, 5)


def test_a_pivot_is_not_refused_for_being_small() -> None:
    """An inequality held by an equality of the same row: all that keeps the system regular is the barrier's term, which falls to 1e-18."""
    dense = np.array(
        [[2.0, 1.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, -1.0], [0.0, 0.0, -1.0, 1e18]]
    )
    factor = Factor(sparse.csr_array(dense))
    assert (int(factor.info[0]), factor.negative) == (0, 2)
    right = np.array([1.0, 2.0, 2.0, -1.0])  # x = 2: the rows agree, the multipliers stay
    assert np.allclose(dense @ factor.solve(right), right, atol=1e-12)


@pytest.mark.parametrize("room", [None, (1, 1)])
@pytest.mark.parametrize("twice", [False, True])
def test_a_matrix_singular_at_every_step_is_told_at_once(
    twice: bool, room: tuple[int, int] | None
) -> None:
    """A gradient that is zero, or a row stated twice, at each step: what cannot be eliminated must not gather in ever larger fronts."""
    steps, random = 400, np.random.default_rng(2)
    one = np.array(
        [[1.0, 0.5, 1.0, 1.0], [0.5, 0.0, 2.0, 2.0], [1.0, 2.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.0]]
    )
    one = one if twice else one * np.outer([1, 1, 1, 0], [1, 1, 1, 0])
    matrix = sparse.lil_array(sparse.kron(sparse.eye_array(steps), one))
    for k in range(steps - 1):
        matrix[4 * k, 4 * k + 5] = matrix[4 * k + 5, 4 * k] = random.normal()
    lower = sparse.tril(matrix, format="coo")
    if not twice:  # the places of the zeros are told, as Ipopt tells them
        zero = 4 * np.arange(steps) + 3
        rows, columns = (
            np.concatenate([lower.row, zero, zero]),
            np.concatenate([lower.col, zero - 1, zero]),
        )
        told = sparse.coo_array(
            (np.concatenate([lower.data, np.zeros(2 * steps)]), (rows, columns)), shape=matrix.shape
        )
    else:
        told = sparse.coo_array(lower)
    factor = Factor(told, room=room)
    assert factor.info[0] == SINGULAR
    assert factor.front.value < 40


def test_hubs_come_last_and_the_rest_stays_sparse() -> None:
    """An arrow with twenty heads: a front per variable of the shaft with the heads for rows, and one of the heads."""
    size, heads, random = 3000, 20, np.random.default_rng(6)
    wings = sparse.csr_array(random.normal(size=(heads, size)))
    matrix = sparse.csr_array(
        sparse.block_array(
            [
                [sparse.eye_array(size), wings.T],
                [wings, sparse.csr_array(random.normal(size=(heads, heads)))],
            ]
        )
    )
    matrix = sparse.csr_array(sparse.tril(matrix) + sparse.tril(matrix, -1).T)
    factor = Factor(matrix)
    assert factor.front.value <= heads + 8
    right = random.normal(size=factor.n)
    assert np.abs(matrix @ factor.solve(right) - right).max() < 1e-8


def test_values_with_other_zero_diagonals_than_the_order_was_made_for() -> None:
    """Ipopt's first system has a diagonal of ones."""
    for seed in range(10):
        random = np.random.default_rng(seed)
        first = chain(random, 25)
        ones = sparse.csr_array(
            first - sparse.diags_array(first.diagonal()) + 1e3 * sparse.eye_array(first.shape[0])
        )
        pattern = sparse.coo_array(sparse.tril(ones))
        factor = Factor(ones)
        values = np.asarray(sparse.csr_array(first)[pattern.row, pattern.col]).ravel()
        factor.again(values)
        whole = first.toarray()
        assert (int(factor.info[0]), factor.negative) == (
            0,
            int((np.linalg.eigvalsh(scaled(whole)[1]) < 0.0).sum()),
        )
        right = random.normal(size=factor.n)
        assert np.abs(whole @ factor.solve(right) - right).max() < 1e-6 * np.abs(right).max()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_called_singular(bad: float) -> None:
    matrix = sparse.csr_array(np.array([[2.0, 1.0], [1.0, bad]]))
    assert Factor(matrix).info[0] == SINGULAR


def test_arrays_that_are_too_short_are_asked_for_longer() -> None:
    matrix = chain(np.random.default_rng(3), 40)
    ample, tight = Factor(matrix), Factor(matrix, room=(1, 1))
    right = np.ones(ample.n)
    assert ample.rooms == 0
    assert tight.rooms >= 2
    assert np.array_equal(ample.solve(right), tight.solve(right))


def test_other_values_of_the_same_pattern_and_factors_side_by_side() -> None:
    random = np.random.default_rng(4)
    first, second = chain(random, 20), chain(random, 30)
    one, other = Factor(first), Factor(second)
    lower = sparse.coo_array(sparse.tril(first))
    values = lower.data + np.where((lower.row == lower.col) & (lower.data < 0.5), 1e-3, 0.0)
    one.again(values)
    changed = sparse.csr_array((values, (lower.row, lower.col)), shape=first.shape)
    changed = changed + sparse.triu(changed.T, 1)
    for factor, matrix in ((one, changed), (other, second)):
        right = random.normal(size=factor.n)
        assert np.abs(matrix @ factor.solve(right) - right).max() < 1e-7


def test_entries_told_twice_are_added() -> None:
    whole = np.array([[2.0, 1.0, 0.0], [1.0, 0.0, 3.0], [0.0, 3.0, 0.0]])
    factor = Factor(sparse.csr_array(whole))
    twice = Factor.__new__(Factor)
    twice.__dict__.update(factor.__dict__)
    twice.rows, twice.columns = np.tile(factor.rows, 2), np.tile(factor.columns, 2)
    twice.rows[len(factor.rows) :], twice.columns[len(factor.rows) :] = (
        factor.columns,
        factor.rows,
    )  # from above the diagonal
    twice.keep, twice.rooms = np.zeros_like(factor.keep), 0
    twice.a, twice.iw = np.zeros(500), np.zeros(500, np.intc)
    lower = sparse.coo_array(sparse.tril(sparse.csr_array(whole)))
    twice.again(np.concatenate([0.25 * lower.data, 0.75 * lower.data]))
    right = np.array([1.0, 2.0, 3.0])
    assert np.allclose(whole @ twice.solve(right), right, atol=1e-14)


def test_the_factor_of_a_plan_grows_with_its_steps_alone() -> None:
    def reals(steps: int) -> float:
        factor = Factor(chain(np.random.default_rng(7), steps))
        entries, place = 0, 1 + int(factor.iw[0])
        for _ in range(factor.steps.value):
            rows, pivots = factor.iw[place : place + 2].tolist()
            entries += rows * pivots
            place += 3 + rows + pivots
        return entries / steps

    assert reals(800) < 1.15 * reals(100)


def solver_of(**options) -> str:
    """Who factorised in a solve that came to its end."""
    result = solve(compile_model(quadratic()), options=options)
    assert result.outcome is Outcome.SOLVED
    return result.options["linear_solver"]


@pytest.fixture
def nobody_asks(monkeypatch):
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER", raising=False)


def test_both_come_to_the_same_plan():
    problem = compile_model(
        build_model(load_scene("three_cart"), ContactFormulation.SOFTPLUS, eps=1e-3)
    )
    ours, theirs = (solve(problem, options={"linear_solver": name}) for name in LINEAR_SOLVERS)
    assert ours.outcome is theirs.outcome is Outcome.SOLVED
    assert (ours.options["linear_solver"], theirs.options["linear_solver"]) == LINEAR_SOLVERS
    assert np.isclose(ours.objective, theirs.objective, rtol=1e-6)
    assert np.allclose(ours.x, theirs.x, rtol=0, atol=1e-4 * np.abs(theirs.x).max())


@pytest.mark.usefixtures("nobody_asks")
def test_ours_is_the_default_and_the_environment_names_another(monkeypatch):
    assert solver_of() == "ldlt"
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "mumps")
    assert solver_of() == "mumps"
    assert solver_of(linear_solver="ldlt") == "ldlt"
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "ma57")
    with pytest.raises(MachineError, match="'ma57'; expected ldlt or mumps"):
        solver_of()


@pytest.mark.usefixtures("nobody_asks")
def test_linear_solver_no_compiler_machine_error(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    assert linear_solver.linear_solver("mumps") == "mumps"
    with pytest.raises(MachineError, match="no C compiler"):
        linear_solver.linear_solver()


@pytest.mark.usefixtures("nobody_asks")
def test_an_ipopt_that_loads_no_solver_is_left_with_mumps(monkeypatch):
    monkeypatch.setattr(linear_solver, "loads_solvers", lambda: False)
    assert solver_of() == "mumps"
    with pytest.raises(MachineError, match="without loading linear solvers"):
        solver_of(linear_solver="ldlt")


_ANOTHER_PROCESS = """
from formulations.ipopt.linear_solver import linear_solver
from models.errors import MachineError
try:
    linear_solver()
except MachineError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("nobody_asks")
def test_linear_solver_damaged_library_machine_error(monkeypatch, tmp_path):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    (tmp_path / "damaged").write_bytes(b"")
    (tmp_path / "damaged").replace(
        linear_solver.ldlt_library()
    )  # not written over: this process has it mapped
    told = subprocess.run(
        [sys.executable, "-c", _ANOTHER_PROCESS], capture_output=True, text=True, check=True
    ).stdout
    assert "cannot be loaded" in told


@pytest.mark.slow
def test_a_library_that_has_gone_is_made_again(monkeypatch, tmp_path):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    first = linear_solver.ldlt_library()
    first.unlink()
    assert solver_of(linear_solver="ldlt") == "ldlt"
    assert first.exists()


@pytest.mark.slow
def test_a_cache_named_from_here_is_built_in(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TOUCHSTONE_CACHE", "beside")
    assert linear_solver.ldlt_library().parent == tmp_path / "beside"


@pytest.mark.usefixtures("nobody_asks")
def test_an_option_of_mumps_asks_for_mumps():
    assert solver_of(mumps_pivtol=1e-3) == "mumps"
    assert solver_of(mumps_pivtol=1e-3, linear_solver="ldlt") == "ldlt"


def test_factor_subnormal_entries_are_scaled():
    factor = Factor(sparse.csr_array(sparse.diags_array(np.array([1e-310, -4e-320, 3.0]))))
    assert factor.negative == 1
    x = factor.solve(np.array([1e-310, 4e-320, 6.0]))
    np.testing.assert_allclose(x, [1.0, -1.0, 2.0], rtol=1e-4)
