"""What Ctrl-C (SIGINT) and SIGTERM do to the program: the first ends it, the next do not disturb the tidying."""

from __future__ import annotations

import signal
from contextlib import contextmanager
from multiprocessing import Pipe
from typing import TYPE_CHECKING, NoReturn

from posor_estimator.starting import SIGNALS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection


@contextmanager
def interruptible() -> Iterator[None]:
    """Until the end of the block, raise KeyboardInterrupt on the first signal and ignore those that follow."""
    with _handled(lambda _number, _frame: _interrupt()):
        yield


@contextmanager
def held_back() -> Iterator[Connection]:
    """Hold signals back until the end of the block; yield what can be read from as soon as there is one."""
    ours, theirs = Pipe(duplex=False)
    with ours, theirs:
        with _handled(lambda number, _frame: theirs.send(number)):
            yield ours
        if ours.poll():
            _interrupt()


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Keep Ctrl-C, which a terminal sends to every process, from those that are started in the block."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


@contextmanager
def _handled(handler: Callable[[int, object], object]) -> Iterator[None]:
    """Handle signals but for those that the program was started to ignore, as a shell does in the background."""
    former = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        for number in SIGNALS:
            if former[number] is not signal.SIG_IGN:
                signal.signal(number, handler)
        yield
    finally:
        for number, before in former.items():
            signal.signal(number, before)


def _interrupt() -> NoReturn:
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
