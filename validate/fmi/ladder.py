"""Steps of a convergence study: the error bar of Co-Simulation comes from results at several steps.

The largest difference of the FINEST results is the error bar. For a method of order one with the
parts 1, 2, 3 and 5 it is four times the error of the finest result, for higher orders more.
"""

from __future__ import annotations

# Numbers by which a communication step is divided: each result costs as much as the two before it,
# and steps are seldom whole multiples of each other.
LADDER = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233, 377)
# Results that an error bar needs: the three finer must differ by less than the three coarser.
FINEST = 4
