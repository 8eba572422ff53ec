"""What the judge is tried on: plans that must hold, plans that must not, and plans that a search makes to cheat it.

    python -m benchmarks verdicts                            # all three groups
    python -m benchmarks verdicts exact wrong --scene three_cart --json verdicts.json
    python -m benchmarks verdicts search --tries 20 --seed 3 --finds finds/

What is expected of each plan is known without the judge: `tests/oracles/scene_motion.py` integrates
the scene by code of its own, `exact` and `wrong` say what they made, and `search` asks the oracle
what is true. Exit code
1 if any verdict differs from what is expected.
"""
