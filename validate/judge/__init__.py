"""Judge a plan by the rule of docs/verdict.md.

from validate.judge import judge
print(judge("three_cart", "plan.csv"))
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from validate.judge.judgement import judge

__all__ = ["judge"]


def __getattr__(name: str) -> object:
    # Child processes import this package without the judge, which takes 0.4 s to import.
    if name == "judge":
        from validate.judge.judgement import judge

        return judge
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
