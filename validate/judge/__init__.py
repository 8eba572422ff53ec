"""Does a plan hold: replayed, measured, and judged by the rule of docs/verdict.md.

from validate.judge import judge
print(judge("three_cart", "plan.csv"))
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from validate.judge.judgement import judge

__all__ = ["judge"]


def __getattr__(name: str) -> object:
    # Who simulates in a child process imports this package too, and needs neither scenes nor
    # scores: 0.4 s.
    if name == "judge":
        from validate.judge.judgement import judge

        return judge
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
