"""Records of runs that went wrong, and of one whose every string is markup.

`factory` is the record factory beside this file.
"""

from dataclasses import replace

from models.results.run import EquationRecord, RunRecord, ShapeRecord
from models.results.verdict import Metric


def crashed(factory) -> RunRecord:
    return factory.run(
        "crashing", None, "strict_lcp", key="crashing-0", stages=(), outcome="crashed",
        message="The process ended with signal 11.",
        verdict="no plan", log_tail="\x1b[31mSegmentation fault\x1b[0m",
    )  # fmt: skip


def out_of_time(factory) -> RunRecord:
    bare = {
        "has_plan": False, "replay": None, "metrics": (), "history": {}, "residuals": {},
        "cost": None, "verdict": "no plan",
    }  # fmt: skip
    late = factory.stage(
        0, "strict_lcp", None, None, 0.0, outcome="time_limit",
        advice="Stopped at its time limit; allow more time, or start it warm.",
        why="there is no plan to score.", **bare,
    )  # fmt: skip
    return factory.run(
        "late",
        None,
        "strict_lcp",
        key="late-0",
        stages=(late,),
        outcome="time_limit",
        verdict="no plan",
        log_tail="",
    )


def refused(factory) -> RunRecord:
    return factory.run(
        "refusing", None, "strict_lcp", key="refusing-0", stages=(), outcome="refused",
        message="The scene has friction, which this method does not know.",
        verdict="not applicable", must_hold=False,
    )  # fmt: skip


def hostile(factory) -> RunRecord:
    """Every string that a scene, a method or a log can bring, made of markup."""
    bad = factory.stage(0, "strict_lcp", None, None, 0.0)
    bad = replace(bad, method=factory.HOSTILE, method_title=factory.HOSTILE, outcome=factory.HOSTILE, advice=factory.HOSTILE, message=factory.HOSTILE, why=factory.HOSTILE, options={factory.HOSTILE: factory.HOSTILE}, residuals={factory.HOSTILE: 1.0}, history={factory.HOSTILE: (3.0, 2.0, 1.0)}, metrics=(Metric(name=factory.HOSTILE, value=None, unit=factory.HOSTILE,
                                     meaning=factory.HOSTILE, reason=factory.HOSTILE),), paper={})  # fmt: skip
    where = replace(
        factory.scene(factory.HOSTILE, factory.HOSTILE),
        source=factory.HOSTILE,
        contacts=(
            factory.contact(
                factory.HOSTILE,
                factory.HOSTILE,
                factory.HOSTILE,
                (factory.HOSTILE, factory.HOSTILE),
            ),
        ),
        equations=(
            EquationRecord(
                caption=factory.HOSTILE, mathml=f"<math><mi>{factory.HOSTILE}</mi></math>"
            ),
            EquationRecord(
                caption="script", mathml="<math><script>document.title='owned'</script></math>"
            ),
        ),
        absent=(factory.HOSTILE,),
        answers=(factory.quantity(factory.HOSTILE, factory.HOSTILE, factory.HOSTILE, 1.0),),
        shapes=(ShapeRecord(name=factory.HOSTILE, kind=factory.HOSTILE, size=(1.0,)),),
    )
    origin = factory.provenance(
        commit=factory.HOSTILE, cpu=factory.HOSTILE, platform=factory.HOSTILE,
        command=factory.HOSTILE, packages={factory.HOSTILE: factory.HOSTILE},
    )  # fmt: skip
    return replace(factory.run(
        "strict", None, "strict_lcp", key="hostile-0", pipeline_title=factory.HOSTILE, scene=where,
        stages=(bad,), outcome=factory.HOSTILE,
        message=factory.HOSTILE, provenance=origin, log_tail=factory.HOSTILE,
    ), pipeline=factory.HOSTILE)  # fmt: skip
