"""Keeps a run apart from whatever else is on this host's ROS network: a domain of its own."""

from __future__ import annotations

import os
import socket
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from posor_estimator.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Iterator

DOMAINS = range(1, 101)
"""Valid on every platform with the standard port mapping of DDS."""
FIRST_LEASE_PORT = 32_768
"""Of ROS's own domain_coordinator: whoever holds this port plus the domain's number has that domain."""


@contextmanager
def leased_domain() -> Iterator[int]:
    """Lease a ROS domain that no other user of this scheme on this host has; the bound port is the lease.

    Raises:
        PosorError: All are taken.

    """
    for domain in DOMAINS:
        with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as lease:
            try:
                lease.bind(("127.0.0.1", FIRST_LEASE_PORT + domain))
            except OSError:
                continue
            yield domain
            return
    raise PosorError("all ROS domains from 1 to 100 are in use on this host", expected="at least one free")


@contextmanager
def own_network() -> Iterator[None]:
    """Set the environment, for this process and those it starts, to a domain of its own on this host only.

    What the user has set stays: ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if os.environ.get("ROS_DOMAIN_ID"):
        yield
        return
    with leased_domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        try:
            yield
        finally:
            del os.environ["ROS_DOMAIN_ID"]
