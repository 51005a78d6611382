"""Several bags at a time, in processes of this machine."""

from __future__ import annotations

import multiprocessing
import signal
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from typing import TYPE_CHECKING

from posor_estimator.errors import PosorError, SystemRefusal
from posor_estimator.reprocess.interrupts import held_back, kept_from_children
from posor_estimator.reprocess.pipeline import reprocess
from posor_estimator.reprocess.task import Summary

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnContext

    from posor_estimator.reprocess.task import Task


def in_processes(tasks: Sequence[Task], jobs: int, progress: Callable[[int, int], object]) -> Iterator[Summary]:
    """Reprocess bags, at most ``jobs`` at a time, each in a process of its own; yield what came of each as it is done.

    Raises:
        PosorError: The first that goes wrong, or a process was ended from outside; those that are at work are finished,
            the others not begun.
        KeyboardInterrupt: The processes have been ended; what came of bags that were done has been yielded.

    """
    if jobs == 1 or len(tasks) == 1:
        for number, task in enumerate(tasks):
            yield reprocess(task, partial(progress, number))
        return
    work = _Work(tasks, progress)
    with held_back() as interruption, _pool(min(jobs, len(tasks))) as workers:
        for worker in workers:
            work.hand_out(worker)
        while at_work := {worker.connection: worker for worker in workers if worker.busy}:
            ready = wait([interruption, *at_work])
            if interruption in ready:
                yield from _rest(workers)
                return
            for connection, worker in at_work.items():
                if connection in ready:
                    yield from work.heard(worker)
    work.check()


class _Work:
    """What is to be done and what has gone wrong."""

    def __init__(self, tasks: Sequence[Task], progress: Callable[[int, int], object]) -> None:
        self._todo = list(enumerate(tasks))
        self._unfinished = dict(self._todo)
        self._progress = progress
        self._errors: list[PosorError] = []
        self._lost: list[_Worker] = []

    def hand_out(self, worker: _Worker) -> None:
        """Give a process the next bag, unless something has gone wrong."""
        if self._todo and not self._errors and not self._lost:
            worker.begin(*self._todo.pop(0))

    def heard(self, worker: _Worker) -> Iterator[Summary]:
        """Take what a process says; yield what came of its bag if that is done."""
        told = worker.told()
        if isinstance(told, int):
            self._progress(worker.number, told)
            return
        worker.busy = False
        if isinstance(told, Summary):
            del self._unfinished[worker.number]
            yield told
        elif told is None:
            self._lost.append(worker)
        else:
            self._errors.append(told)
        self.hand_out(worker)

    def check(self) -> None:
        """Raise what went wrong first.

        Raises:
            PosorError: A bag could not be reprocessed, or a process was ended from outside.

        """
        if self._errors:
            raise self._errors[0]
        if self._lost:
            code = self._lost[0].wait() or 0
            how = f"by signal {-code}, {signal.strsignal(-code)}" if code < 0 else f"with exit code {code}"
            raise SystemRefusal(
                f"not finished, since a process of the program was ended {how}",
                where=", ".join(str(task.bag) for task in self._unfinished.values()),
                expected="memory for as many bags at a time, or a smaller --jobs" if code == -signal.SIGKILL else "",
            )


class _Worker:
    """A process that reprocesses one bag after the other.

    Attributes:
        connection: Where it can be heard.
        number: Of the bag that it was given last.
        busy: Whether it is at it.

    """

    def __init__(self, context: SpawnContext) -> None:
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()  # so that the end of the process is heard
        self.number = 0
        self.busy = False

    def begin(self, number: int, task: Task) -> None:
        """Hand over a bag."""
        self.number, self.busy = number, True
        with suppress(OSError):  # it has ended, which the next ``told`` tells
            self.connection.send(task)

    def told(self) -> int | Summary | PosorError | None:
        """Return what it says: scans done since it said so last, what came of the bag, or None: it has ended."""
        try:
            said: int | Summary | PosorError = self.connection.recv()
        except (EOFError, OSError):
            return None
        return said

    def end(self) -> None:
        """End it at once, if it has not ended."""
        self._process.kill()
        self._process.join()

    def wait(self) -> int | None:
        """Wait for the end and return the exit code."""
        self._process.join()
        return self._process.exitcode


@contextmanager
def _pool(count: int) -> Iterator[list[_Worker]]:
    """Yield so many processes, which are ended at once at the end of the block."""
    context = multiprocessing.get_context("spawn")  # forked threads of numba and rclpy would not be sound
    resource_tracker.ensure_running()  # by itself it would begin with the first process, and let signals through again
    with kept_from_children():
        workers = [_Worker(context) for _ in range(count)]
    try:
        yield workers
    finally:
        for worker in workers:
            worker.end()


def _rest(workers: Sequence[_Worker]) -> Iterator[Summary]:
    """End the processes and yield what came of the bags that were done, but had not been heard of."""
    for worker in workers:
        worker.end()
    for worker in workers:
        while (told := worker.told()) is not None:
            if isinstance(told, Summary):
                yield told


def _serve(connection: Connection) -> None:
    """Reprocess one bag after the other, in a process of its own, until nobody listens any more."""
    with suppress(EOFError, ConnectionError):
        while True:
            connection.send(_outcome(connection.recv(), connection.send))


def _outcome(task: Task, progress: Callable[[int], object]) -> Summary | PosorError:
    try:
        return reprocess(task, progress)
    except PosorError as error:
        return error
