"""MacMPEC (S. Leyffer), its small problems, written anew for Pyomo with the published optima.

Here, 88 of the 193 of the collection: bard1 to 3 and bard1m to 3m, bilevel1 to 3, bilevel1m,
bilevel2m, bilin, dempe, design-cent-1, desilva, df1, ex9.1.1 and 3 to 10, ex9.2.1 to 9, flp2,
gauvin, gnash10 to 19 and 10m to 19m, hakonsen, hs044-i, jr1, jr2, kth1 to 3, nash1a to e, outrata31
to 34, qpec1, qpec2, ralph1, ralph2, scale1 to 5, scholtes1 to 5, sl1, stackelberg1.

Not here: ex9.1.2 (it has a binary variable, which is refused); not written down yet, with at most
13 pairs: bar-truss-3, design-cent-2, 21, 3, 31 and 4, portfl-i-1 to 6, taxmcp, water-net; with 30
to 1748 pairs, most with data of their own: bem-milanc30-s, flp4, incid-set, liswet1, monteiro,
pack-comp, pack-rig, qpec-100 and 200, ralphmod, siouxfls, tap-09, tap-15, TrafficSignalCycle,
water-FL. `python -m benchmarks mpec-growth` stands for the large ones: 100 to 3025 pairs.
"""

from benchmarks.mpec.macmpec import bard, bilevel, equilibria, floudas, scholtes, toy
from benchmarks.mpec.macmpec.problem import PROBLEMS

__all__ = ["PROBLEMS", "bard", "bilevel", "equilibria", "floudas", "scholtes", "toy"]
