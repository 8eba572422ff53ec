"""Our factorisation called as Ipopt calls it, and matrices of the kinds it meets."""

import ctypes

import numpy as np
import scipy.sparse as sparse

from formulations.ipopt.linear_solver import ldlt_library

SINGULAR = -5
INTEGERS = -3
REALS = -4


def _p(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _i(number: int):
    return ctypes.byref(ctypes.c_int(number))


class Factor:
    """What Ipopt's interface to MA27 does: room as it is told, more when asked for. rooms: how often more was asked for."""

    def __init__(
        self, matrix: sparse.sparray, pivot: float = 1e-8, room: tuple[int, int] | None = None
    ) -> None:
        lower = sparse.coo_array(sparse.tril(matrix))
        self.n = int(matrix.shape[0])
        self.rows, self.columns = (lower.row + 1).astype(np.intc), (lower.col + 1).astype(np.intc)
        self.keep, self.icntl, self.cntl = (
            np.zeros(3 * self.n, np.intc),
            np.zeros(30, np.intc),
            np.zeros(5),
        )
        self.info, self.spare, self.steps = (
            np.zeros(20, np.intc),
            np.zeros(2 * self.n + 1, np.intc),
            ctypes.c_int(0),
        )
        self.library = ctypes.CDLL(str(ldlt_library()))
        self.library.ma27id_(_p(self.icntl), _p(self.cntl))
        self.cntl[0] = pivot
        self.library.ma27ad_(
            _i(self.n), _i(lower.nnz), _p(self.rows), _p(self.columns), _p(self.spare),
            _i(len(self.spare)), _p(self.keep), _p(self.spare),
            ctypes.byref(self.steps), _i(0), _p(self.icntl), _p(self.cntl), _p(self.info),
            ctypes.byref(ctypes.c_double(0.0)),
        )  # fmt: skip
        reals, integers = room or (5 * int(self.info[4]), 5 * int(self.info[5]))
        self.rooms = 0
        self.iw, self.front = np.zeros(integers, np.intc), ctypes.c_int(0)
        self.a = np.zeros(max(reals, lower.nnz))
        self.again(lower.data)

    def again(self, values: np.ndarray) -> None:
        while True:
            self.a[: len(values)] = values
            self.library.ma27bd_(
                _i(self.n), _i(len(values)), _p(self.rows), _p(self.columns), _p(self.a),
                _i(len(self.a)), _p(self.iw), _i(len(self.iw)),
                _p(self.keep), ctypes.byref(self.steps), ctypes.byref(self.front), _p(self.spare),
                _p(self.icntl), _p(self.cntl), _p(self.info),
            )  # fmt: skip
            if self.info[0] not in (INTEGERS, REALS):
                return
            self.rooms += 1
            self.a, self.iw = (
                np.full(
                    max(len(values), self.info[1] if self.info[0] == REALS else len(self.a)), np.nan
                ),
                np.full(self.info[1] if self.info[0] == INTEGERS else len(self.iw), -1, np.intc),
            )

    @property
    def negative(self) -> int:
        return int(self.info[14])

    def solve(self, right: np.ndarray) -> np.ndarray:
        x, work = right.astype(float), np.zeros(self.front.value)
        self.library.ma27cd_(
            _i(self.n), _p(self.a), _i(len(self.a)), _p(self.iw), _i(len(self.iw)), _p(work),
            ctypes.byref(self.front), _p(x), _p(self.spare),
            ctypes.byref(self.steps), _p(self.icntl), _p(self.info),
        )  # fmt: skip
        return x


def symmetric(matrix: sparse.sparray) -> sparse.csr_array:
    return sparse.csr_array(matrix + matrix.T)


def saddle(random: np.random.Generator, n: int) -> sparse.csr_array:
    m = int(random.integers(0, n + 1))
    hessian = symmetric(sparse.random_array((n, n), density=0.1, rng=random)) + sparse.diags_array(
        random.normal(size=n)
    )
    jacobian = sparse.random_array((m, n), density=0.2, rng=random) + sparse.eye_array(m, n)
    return sparse.csr_array(
        sparse.block_array([[hessian, jacobian.T], [jacobian, None]]) if m else hessian
    )


def no_diagonal(random: np.random.Generator, n: int) -> sparse.csr_array:
    matrix = symmetric(sparse.random_array((n, n), density=min(1.0, 4 / n), rng=random))
    return sparse.csr_array(matrix - sparse.diags_array(matrix.diagonal()))


def arrow(random: np.random.Generator, n: int) -> sparse.csr_array:
    matrix = np.diag(random.normal(size=n) * (np.arange(n) > 1))
    matrix[0, :] = matrix[:, 0] = random.normal(size=n)
    return sparse.csr_array(matrix)


def wide_range(random: np.random.Generator, n: int) -> sparse.csr_array:
    diagonal = 10.0 ** random.uniform(-12, 12, n) * np.sign(random.normal(size=n))
    return sparse.csr_array(
        symmetric(sparse.random_array((n, n), density=min(1.0, 5 / n), rng=random))
        + sparse.diags_array(diagonal)
    )


def chain(
    random: np.random.Generator, steps: int, states: int = 4, inputs: int = 2
) -> sparse.csr_array:
    """The optimality system of a plan, in an order that says nothing of time."""
    size = states + inputs
    jacobian = sparse.lil_array((states * (steps - 1), size * steps))
    for k in range(steps - 1):
        jacobian[k * states : (k + 1) * states, k * size : (k + 1) * size] = 0.4 * random.normal(
            size=(states, size)
        )
        jacobian[k * states : (k + 1) * states, (k + 1) * size : (k + 1) * size + states] = -np.eye(
            states
        )
    is_input = np.arange(size * steps) % size >= states
    hessian = sparse.diags_array(
        random.uniform(0.1, 1.0, size * steps)
        * (is_input | (random.uniform(size=size * steps) < 0.6))
    )
    matrix = sparse.csr_array(sparse.block_array([[hessian, jacobian.T], [jacobian, None]]))
    order = random.permutation(matrix.shape[0])
    return sparse.csr_array(matrix[order][:, order])


def dense(random: np.random.Generator, n: int) -> sparse.csr_array:
    """One front of several panels, a part of whose diagonal is zero."""
    matrix = random.normal(size=(2 * n, 2 * n))
    matrix = matrix + matrix.T
    zero = random.permutation(2 * n)[: int(random.integers(0, 2 * n))]
    matrix[zero, zero] = 0.0
    if n % 2:
        matrix[np.ix_(zero[: n // 2], zero[: n // 2])] = 0.0
    return sparse.csr_array(matrix)


def grid(random: np.random.Generator, n: int) -> sparse.csr_array:
    """A saddle point on a square with large separators."""
    side = 8 + n // 6
    line = sparse.diags_array([np.ones(side - 1)], offsets=[1])
    neighbours = sparse.kron(line, sparse.eye_array(side)) + sparse.kron(
        sparse.eye_array(side), line
    )
    weighted = sparse.coo_array(neighbours)
    weighted.data = random.normal(size=weighted.nnz)
    free = random.uniform(size=side * side) < 0.5
    return sparse.csr_array(
        symmetric(sparse.csr_array(weighted)) + sparse.diags_array(np.where(free, 1.0, 0.0) + 1e-3)
    )


def hubs(random: np.random.Generator, n: int) -> sparse.csr_array:
    """Chains with rows that touch nearly all of it, one another among them, and a variable that stands in every row."""
    size, count = 140 + 2 * n, int(random.integers(1, 6))
    matrix = sparse.lil_array((size + count, size + count))
    matrix.setdiag(
        np.concatenate(
            [random.normal(size=size) * (random.uniform(size=size) < 0.8), np.zeros(count)]
        )
    )
    for i in range(size - 1):
        if random.uniform() < 0.9:
            matrix[i, i + 1] = matrix[i + 1, i] = random.normal()
    for h in range(size, size + count):
        touched = np.flatnonzero(random.uniform(size=h) < 0.9)
        matrix[h, touched] = random.normal(size=len(touched))
        matrix[touched, h] = matrix[h, touched]
    order = random.permutation(size + count)
    matrix = sparse.csr_array(matrix)
    return sparse.csr_array(matrix[order][:, order])


def scaled(dense: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    scale = np.ones(len(dense))
    for _ in range(5):
        scale /= np.sqrt(np.abs(scale[:, None] * dense * scale).max(axis=0))
    return scale, scale[:, None] * dense * scale
