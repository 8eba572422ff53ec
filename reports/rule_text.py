"""What makes a campaign fail, in words: apart from the rule itself (reports.rule), because --help shows them and must not cost pydantic."""

from __future__ import annotations

# What fails a campaign, each ending a sentence that begins "A campaign fails if".
RULE = (
    "a run crashed, or failed in a way that its method does not explain, whatever the method",
    "a direct method reports success, and its plan does not hold - or holds only with feedback on a scene that does not say, with a reason, that it is unstable",
    "a direct method's plan of a row of the paper's Table I does not hold",
    "direct methods ran on a scene, and no run of that scene holds, with feedback or without",
    "on a scene without inputs the replay misses a closed form, or fails its own checks",
    "a check (of one of our own FMUs, a stress case) finds a fault, or ends without an answer",
)
# What does not.
RESULTS = (
    "A method that says itself that it stopped at a limit, stalled, diverged, found no plan or does not apply to the scene has given a result, "
    "which fails nothing.",
    "A relaxed (indirect) method is expected to violate contact physics: the report shows by how much.",
    "A plan that fails by its time step alone - it is a plan of the task, says that it reaches the goal, has physical forces and solves its own discrete "
    "equations, and what it misses shrinks as its grid is refined - is a finding about the grid: it is listed, but fails nothing.",
    "A scene without inputs has nothing to plan: its free motion is replayed and held against closed forms.",
)
