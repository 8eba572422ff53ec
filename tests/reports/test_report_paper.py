"""The paper's Table I against a second copy of its numbers, read off the paper once more."""

from reports.paper import TABLE_1, TIGHTENING_FIGURES

# Methods, eps, then cost, stability, physics, time, as printed.
PRINTED = """
strict_lcp              -     40779.28 0.00    0.00   31.56
relu_gd                 -       542.56 0.04    0.16   49.59
relaxed_lcp             1e-2    484.21 0.00    2.99 1407.90
relaxed_lcp             1e-3    561.00 0.00    0.34  580.77
relaxed_lcp             1e-4    469.94 0.00    0.03  430.16
relaxed_lcp strict_lcp  -     46415.20 0.00    0.00   20.73
relaxed_lcp relu_gd     -       492.06 0.00    0.20    0.27
softplus_dc             1e-3    197.86 0.00 2445.98   11.64
softplus_dc             1e-5    261.23 0.00  625.11    9.78
softplus_dc             1e-7    339.53 0.00  239.50   12.40
softplus_dc strict_lcp  -     16619.35 0.00    0.00  100.07
softplus_dc relu_gd     -       360.31 0.00    0.20    1.43
softplus_gd             1e-3    149.18 0.41    0.01    4.07
softplus_gd             1e-5    166.45 0.27    0.11    3.77
softplus_gd             1e-7    215.14 0.20    0.12    2.94
softplus_gd strict_lcp  -      3748.30 0.00    0.00  151.54
softplus_gd relu_gd     -       309.42 0.05    0.21    2.38
"""


def test_table_one():
    for row, line in zip(TABLE_1, PRINTED.split("\n")[1:-1], strict=True):
        *methods, eps, cost, stability, physics, time = line.split()
        assert row.methods == tuple(methods), line
        assert row.eps == (None if eps == "-" else float(eps)), line
        assert row.numbers == {"cost": float(cost), "stability": float(stability), "physics": float(physics), "time": float(time)}, line


def test_figures():
    assert TIGHTENING_FIGURES == {"softplus_dc": "Fig. 4", "softplus_gd": "Fig. 5", "relaxed_lcp": "Fig. 6"}
