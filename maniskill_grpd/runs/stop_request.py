"""Signals that ask a process to stop, taken note of instead of obeyed at once."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from types import FrameType

SIGNALS = tuple(signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in signal.Signals.__members__)
"""Ctrl-C, the request of a launcher or a shutdown, and a terminal that is closed."""


class StopRequest:
    """Whether this process was asked to stop; calling it tells.

    Attributes:
        received: The first signal that asked, None as long as there was none.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None

    def __call__(self) -> bool:
        """Return whether a signal has asked."""
        return self.received is not None

    @property
    def exit_code(self) -> int:
        """What shells expect of a process that a signal ended."""
        return 128 + (self.received or 0)

    def handle(self, number: int, _: FrameType | None) -> None:
        """Take note of a signal; the same one again is obeyed at once.

        A launcher may send another one after the Ctrl-C that all processes of a terminal get.
        """
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
        if self.received is None:
            self.received = signal.Signals(number)
            print(f"{self.received.name}: stops after this iteration; a second one stops at once", file=sys.stderr, flush=True)


@contextlib.contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Listen for signals that ask to stop; what this process ignores (`nohup`) it goes on ignoring."""
    request = StopRequest()
    before = {number: signal.getsignal(number) for number in SIGNALS}
    heard = [number for number in SIGNALS if before[number] != signal.SIG_IGN]
    for number in heard:
        signal.signal(number, request.handle)
    try:
        yield request
    finally:
        for number in heard:
            signal.signal(number, before[number])
