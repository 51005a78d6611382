"""Several bags at a time: in processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from threading import Thread
from typing import TYPE_CHECKING, Any

from posor_estimator.errors import ParameterError
from posor_estimator.reprocess.pipeline import reprocess

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from posor_estimator.reprocess.task import Summary, Task

CONNECT_WITHIN_S = 10
"""How long a cluster may take to answer."""


def in_processes(tasks: Sequence[Task], jobs: int, progress: Callable[[int, int], object]) -> Iterator[Summary]:
    """Reprocess bags, at most ``jobs`` at a time, each in a process of its own; yield what came of each as it is done.

    Raises:
        PosorError: The first that goes wrong; those that are at work are finished, the others not begun.

    """
    if jobs == 1 or len(tasks) == 1:
        for number, task in enumerate(tasks):
            yield reprocess(task, partial(progress, number))
        return
    context = multiprocessing.get_context("spawn")  # forked threads of numba and rclpy would not be sound
    said = context.SimpleQueue()
    listening = Thread(target=_listen, args=(said, progress), daemon=True)
    listening.start()
    try:
        with ProcessPoolExecutor(min(jobs, len(tasks)), context, _begin, (said,)) as pool:
            futures = [pool.submit(_reprocess, number, task) for number, task in enumerate(tasks)]
            try:
                for future in as_completed(futures):
                    yield future.result()
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
    finally:
        said.put(None)
        listening.join()


def on_cluster(tasks: Sequence[Task], scheduler: str) -> Iterator[Summary]:
    """Reprocess bags on a Dask cluster, whose workers see the same files; yield what came of each as it is done.

    A bag whose worker is lost is done again by another.

    Raises:
        ParameterError: Dask is not installed, or no scheduler answers.
        PosorError: The first that goes wrong.

    """
    try:
        import distributed  # noqa: PLC0415  an optional library
    except ImportError:
        raise ParameterError(
            "Dask is not installed", where="option --scheduler", expected="the Python library 'distributed'"
        ) from None
    dask: Any = distributed
    try:
        client = dask.Client(scheduler, timeout=CONNECT_WITHIN_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ParameterError(
            f"no Dask scheduler answers at {scheduler}", where="option --scheduler", expected="such as tcp://host:8786"
        ) from error
    with client:
        futures = client.map(reprocess, tasks, pure=False, retries=0)
        try:
            for future in dask.as_completed(futures, loop=client.loop):
                yield future.result()
        finally:
            client.cancel(futures)


_said: Any = None


def _begin(said: Any) -> None:
    """Remember, in a process of the pool, where progress is told."""
    global _said  # noqa: PLW0603  a pool has no other way to give a process something
    _said = said


def _reprocess(number: int, task: Task) -> Summary:
    return reprocess(task, lambda count: _said.put((number, count)))


def _listen(said: Any, progress: Callable[[int, int], object]) -> None:
    for number, count in iter(said.get, None):
        progress(number, count)
