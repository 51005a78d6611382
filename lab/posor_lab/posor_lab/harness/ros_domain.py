# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Isolates a run from other ROS programs on this host by a domain of its own."""

from __future__ import annotations

import os
import socket
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from posor.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Iterator

DOMAINS = range(1, 101)  # valid on every platform with the standard port mapping of DDS
FIRST_LEASE_PORT = 32_768
"""Convention of ROS's domain_coordinator: who binds this port plus the domain number owns the domain."""


@contextmanager
def leased_domain() -> Iterator[int]:
    """Lease a ROS domain that no other user of this scheme on this host holds; the bound port is the lease.

    Raises PosorError: all domains are in use.
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
def isolated_network() -> Iterator[None]:
    """Set the environment of this process and its children to a leased domain on this host only.

    Variables set by the user stay: ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE.
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
