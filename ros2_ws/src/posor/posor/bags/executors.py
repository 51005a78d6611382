# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs tasks on several bags at a time, in local processes or on a Dask cluster, through ``concurrent.futures``."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import ssl
import threading
import time
from _thread import interrupt_main
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from ipaddress import ip_address
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, Protocol, TypeVar
from urllib.parse import urlsplit

from posor.errors import ParameterError, PosorError, SystemRefusal
from posor.lazy_program import interrupts_blocked

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

CONNECT_WITHIN_S = 10  # time limit for the answer of a cluster
END_WITHIN_S = 5.0  # time limit for a worker to remove its unfinished results after the program has been killed
ENCRYPTED_SCHEMES = ("tls", "wss")
SCHEMES = ("tcp", "ws", *ENCRYPTED_SCHEMES)
OPTION = "option --scheduler"
EXPECTED = "an address such as tls://host:8786"


class BagTask(Protocol):
    """A task that names its bag."""

    @property
    def bag(self) -> Path:
        """Folder or file."""


TaskT = TypeVar("TaskT", bound=BagTask)
ResultT = TypeVar("ResultT")


def run_tasks(
    executor: Executor, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT], at_once: int
) -> Iterator[ResultT]:
    """Yield the result of each task as soon as it is finished.

    ``executor``: runs the tasks; ``function``: called with each task, in the executor; ``tasks``: the tasks; after an
    error no further ones are started, and those at work are finished; ``at_once``: number of tasks that are submitted
    at a time. Raises PosorError: the first error of a task; SystemRefusal: a worker process was terminated; all others
    are terminated too.
    """
    waiting, running = list(tasks), dict[Future[ResultT], TaskT]()
    first_error: PosorError | None = None
    processes: dict[int | None, Any] = {}
    try:
        while running or (waiting and first_error is None):
            while waiting and len(running) < at_once and first_error is None:
                with interrupts_blocked():  # a worker keeps the block of SIGINT, the Ctrl-C of a terminal
                    running[executor.submit(function, waiting[0])] = waiting[0]
                waiting.pop(0)
                processes |= {process.pid: process for process in multiprocessing.active_children()}
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                error = future.exception()
                if isinstance(error, PosorError):
                    first_error = first_error or error
                else:
                    yield future.result()
                del running[future]
    except BrokenProcessPool:
        executor.shutdown()
        unfinished = [task for task in tasks if task in running.values() or task in waiting]
        raise _terminated_worker(processes.values(), unfinished) from None
    except BaseException:
        if isinstance(executor, ProcessPoolExecutor):
            for process in multiprocessing.active_children():
                process.kill()
        _cancel_all(executor, running)
        raise
    if first_error is not None:
        raise first_error


def _cancel_all(executor: Executor, running: Iterable[Future[ResultT]]) -> None:
    """Cancel tasks and shut an executor down; that of Dask has no ``cancel_futures``."""
    for future in running:
        future.cancel()
    executor.shutdown(wait=False)


@contextmanager
def local_processes(count: int) -> Iterator[Executor]:
    """Yield an executor with worker processes of this machine."""
    context = multiprocessing.get_context("spawn")  # a fork would copy the locks of numba's threads
    resource_tracker.ensure_running()  # started with the first worker, it would unblock signals
    with ProcessPoolExecutor(count, mp_context=context, initializer=_init_worker) as executor:
        yield executor


@contextmanager
def dask_cluster(scheduler: str, *, unencrypted: bool = False) -> Iterator[Executor]:
    """Yield an executor on a Dask cluster whose workers see the same files.

    A task whose worker is lost is done again by another worker. ``scheduler``: address of the scheduler; the
    certificates for TLS are those of Dask's configuration; ``unencrypted``: whether a scheduler on another machine may
    be used without TLS. Raises ParameterError: the address is invalid or not encrypted, Dask is not installed, the
    certificates cannot be used, or no scheduler answers.
    """
    _check_address(scheduler, unencrypted=unencrypted)
    try:
        import distributed  # noqa: PLC0415  an optional library
    except ImportError:
        raise ParameterError(
            "Dask is not installed", where=OPTION, expected="the Python library 'distributed'"
        ) from None
    dask: Any = distributed
    security = _connection_security(dask, scheduler)
    try:
        asyncio.run(_ping_scheduler(dask, scheduler, security))
        client = dask.Client(scheduler, timeout=CONNECT_WITHIN_S, set_as_default=False)
    except (OSError, ValueError) as error:
        if isinstance(error.__cause__, ssl.SSLError):
            raise ParameterError(
                f"the scheduler at {scheduler} and this program do not accept each other's certificates",
                where=OPTION,
                expected="certificates of one authority, see docs/how_to/secure_network.md",
            ) from error
        raise ParameterError(f"no Dask scheduler answers at {scheduler}", where=OPTION, expected=EXPECTED) from error
    with client:
        yield client.get_executor(pure=False, retries=0)


def _terminated_worker(processes: Any, unfinished: Sequence[BagTask]) -> SystemRefusal:
    """Return the error for a terminated worker; the executor then sends SIGTERM to the other workers."""
    codes = [process.exitcode for process in processes if process.exitcode not in (None, 0, -signal.SIGTERM)]
    code = codes[0] if codes else -signal.SIGTERM
    how = f"by signal {-code}, {signal.strsignal(-code)}" if code < 0 else f"with exit code {code}"
    return SystemRefusal(
        f"not finished, since a process of the program was ended {how}",
        where=", ".join(str(task.bag) for task in unfinished),
        expected="memory for as many bags at a time, or a smaller --jobs" if code == -signal.SIGKILL else "",
    )


def _init_worker() -> None:
    """Allow SIGTERM, and end this worker when the program has been killed: its queue of tasks would keep it waiting."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def end_with_parent() -> None:
        parent.join()
        interrupt_main()  # KeyboardInterrupt: unfinished results are removed
        time.sleep(END_WITHIN_S)
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _check_address(scheduler: str, *, unencrypted: bool) -> None:
    """Refuse an invalid address, and the address of another machine without TLS."""
    try:
        address = urlsplit(scheduler)
        rest = address.path or address.query or address.fragment or address.username
        is_valid = address.scheme in SCHEMES and bool(address.hostname) and bool(address.port) and not rest
    except ValueError:
        is_valid = False
    if not is_valid:
        raise ParameterError(f"'{scheduler}'", where=OPTION, expected=EXPECTED)
    is_here = address.hostname == "localhost"
    with suppress(ValueError):  # a name
        is_here = is_here or ip_address(address.hostname or "").is_loopback
    if not (unencrypted or is_here or address.scheme in ENCRYPTED_SCHEMES):
        raise ParameterError(
            f"{scheduler} is on another machine and not encrypted: whoever reaches it runs code on its workers",
            where=OPTION,
            expected="a tls:// address, or --unencrypted too",
        )


def _connection_security(dask: Any, scheduler: str) -> dict[str, Any]:
    """Return Dask's arguments of a connection, with the certificates of Dask's configuration."""
    expected = "'distributed.comm.tls' in Dask's configuration, see docs/how_to/secure_network.md"
    try:
        security: dict[str, Any] = dask.Security().get_connection_args("client")
    except OSError as error:
        raise ParameterError(
            f"the certificates cannot be used: {error}", where=OPTION, expected=f"those of {expected}"
        ) from error
    encrypted = urlsplit(scheduler).scheme in ENCRYPTED_SCHEMES
    if security["require_encryption"] and not encrypted:
        raise ParameterError(
            f"{scheduler} is not encrypted", where=OPTION, expected="tls://, as Dask's configuration says"
        )
    if encrypted and security.get("ssl_context") is None:
        raise ParameterError("there are no certificates for TLS", where=OPTION, expected=expected)
    return security


async def _ping_scheduler(dask: Any, scheduler: str, security: dict[str, Any]) -> None:
    """Connect to the scheduler once: a client without an answer cannot be closed, and may wait for ever."""
    async with asyncio.timeout(CONNECT_WITHIN_S):
        comm = await dask.comm.connect(scheduler, CONNECT_WITHIN_S, **security)
    await comm.close()
