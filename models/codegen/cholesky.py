"""Solving M x = b for a mass matrix that depends on q: Cholesky, written out for the entries that are not always zero.

Two fingers and a disc have seven coordinates, but only two blocks of two in their mass matrix: what is zero for every q is not computed. The
order of operations is that of the usual loops.
"""

from __future__ import annotations

import sympy as sp

_HEAD = """\
/* Factorises the symmetric positive definite M = L L' in place (lower triangle), then solves M x = b in place; entries that are zero for
 * every q are left out. Returns 1 if M is not positive definite, else 0. */
SCENE_FUNCTION int scene_solve(double M[NQ][NQ], double *b)
{
"""


def cholesky_function(mass: sp.Matrix) -> str:
    """C of `scene_solve` for a mass matrix with the zeros of this one."""
    lower = _factor_pattern(mass)
    n = mass.rows
    lines: list[str] = []
    for j in range(n):
        lines += [f"M[{j}][{j}] -= M[{j}][{k}]*M[{j}][{k}];" for k in range(j) if (j, k) in lower]
        lines += [f"if (!(M[{j}][{j}] > 0.0)) return 1;", f"M[{j}][{j}] = sqrt(M[{j}][{j}]);"]
        for i in range(j + 1, n):
            if (i, j) in lower:
                lines += [f"M[{i}][{j}] -= M[{i}][{k}]*M[{j}][{k}];" for k in range(j) if (i, k) in lower and (j, k) in lower]
                lines.append(f"M[{i}][{j}] /= M[{j}][{j}];")
    for i in range(n):
        lines += [f"b[{i}] -= M[{i}][{k}]*b[{k}];" for k in range(i) if (i, k) in lower]
        lines.append(f"b[{i}] /= M[{i}][{i}];")
    for i in reversed(range(n)):
        lines += [f"b[{i}] -= M[{k}][{i}]*b[{k}];" for k in range(i + 1, n) if (k, i) in lower]
        lines.append(f"b[{i}] /= M[{i}][{i}];")
    return "".join([_HEAD, *(f"    {line}\n" for line in lines), "    return 0;\n}\n"])


def _factor_pattern(mass: sp.Matrix) -> set[tuple[int, int]]:
    """Entries (i, j), i > j, of L that are not always zero: those of M, and the fill that eliminating a column makes."""
    n = mass.rows
    lower = {(i, j) for i in range(n) for j in range(i) if mass[i, j] != 0}
    for k in range(n):
        below = [i for i in range(k + 1, n) if (i, k) in lower]
        lower |= {(i, j) for i in below for j in below if i > j}
    return lower
