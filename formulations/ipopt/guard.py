"""Keeps exceptions from crossing Ipopt, whose wrappers lose some of them.

cyipopt forgets what the Hessian raises - Ctrl-C there is swallowed and the solve runs on - and ipyopt lets errors surface later, as
something else. So the first unexpected error of any callback is kept here, the solve is stopped at the next iteration, and the back
end raises the error afterwards, as it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any


class Guard:
    """Wraps the callbacks of one solve. `evaluation_error` is what the back end understands as 'this point cannot be evaluated'."""

    def __init__(self, intermediate: Callable[..., bool], evaluation_error: type[Exception], limit: float | None = None) -> None:
        self.error: BaseException | None = None
        self.out_of_time = False
        self._intermediate = intermediate
        self._evaluation_error = evaluation_error
        self._deadline = None if limit is None else time.perf_counter() + limit

    def function(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, raising nothing but `evaluation_error`."""

        def call(*arguments: Any) -> Any:
            if self.error is not None:
                raise self._evaluation_error("the solve is being stopped")
            try:
                return function(*arguments)
            except self._evaluation_error:
                raise
            except BaseException as error:
                self.error = error
                raise self._evaluation_error("the solve is being stopped") from error

        return call

    def intermediate(self, *arguments: Any) -> bool:
        """Ipopt's question after each iteration, whether to go on."""
        if self.error is not None:
            return False
        if self._deadline is not None and time.perf_counter() >= self._deadline:
            self.out_of_time = True
            return False
        try:
            return bool(self._intermediate(*arguments))
        except BaseException as error:  # noqa: BLE001 - kept and raised after the solve, KeyboardInterrupt too
            self.error = error
            return False

    def raise_kept(self) -> None:
        """Raise the error that was kept, if any."""
        if self.error is not None:
            raise self.error
