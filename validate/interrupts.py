"""What must not be cut short by Ctrl-C: it is held back for a moment, and heard then."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# What ends a campaign in words: Ctrl-C, a polite kill, a closed terminal.
ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """What would raise KeyboardInterrupt raises it when the block has ended; the second of them at once. Outside the main thread nothing is held back."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []

    def hear(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        if len(heard) > 1:
            signal.default_int_handler(number, frame)

    mine = [number for number in ENDING if signal.getsignal(number) is signal.default_int_handler]
    for number in mine:
        signal.signal(number, hear)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.default_int_handler)
    if heard:
        raise KeyboardInterrupt
