"""Several bags at a time, on a Dask cluster."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from posor_estimator.errors import ParameterError
from posor_estimator.reprocess.pipeline import reprocess

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor_estimator.reprocess.task import Summary, Task

CONNECT_WITHIN_S = 10
"""How long a cluster may take to answer."""
SCHEMES = ("tcp", "tls", "ws", "wss")
OPTION = "option --scheduler"
EXPECTED = "an address such as tcp://host:8786"


def on_cluster(tasks: Sequence[Task], scheduler: str) -> Iterator[Summary]:
    """Reprocess bags on a Dask cluster, whose workers see the same files; yield what came of each as it is done.

    A bag whose worker is lost is done again by another.

    Raises:
        ParameterError: The address cannot be one, Dask is not installed, or no scheduler answers.
        PosorError: The first that goes wrong.

    """
    if not _is_address(scheduler):
        raise ParameterError(f"'{scheduler}'", where=OPTION, expected=EXPECTED)
    try:
        import distributed  # noqa: PLC0415  an optional library
    except ImportError:
        raise ParameterError(
            "Dask is not installed", where=OPTION, expected="the Python library 'distributed'"
        ) from None
    dask: Any = distributed
    try:
        asyncio.run(_ask(dask, scheduler))
        client = dask.Client(scheduler, timeout=CONNECT_WITHIN_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ParameterError(f"no Dask scheduler answers at {scheduler}", where=OPTION, expected=EXPECTED) from error
    with client:
        futures = client.map(reprocess, tasks, pure=False, retries=0)
        try:
            for future in dask.as_completed(futures, loop=client.loop):
                yield future.result()
        finally:
            client.cancel(futures)


def _is_address(text: str) -> bool:
    try:
        address = urlsplit(text)
        port = address.port
    except ValueError:
        return False
    rest = address.path or address.query or address.fragment or address.username
    return address.scheme in SCHEMES and bool(address.hostname) and bool(port) and not rest


async def _ask(dask: Any, scheduler: str) -> None:
    """Greet the scheduler: a client that gets no answer cannot be closed, and may wait for one without end.

    Raises:
        OSError: It does not greet back in time.

    """
    security = dask.Security().get_connection_args("client")
    async with asyncio.timeout(CONNECT_WITHIN_S):
        comm = await dask.comm.connect(scheduler, CONNECT_WITHIN_S, **security)
    await comm.close()
