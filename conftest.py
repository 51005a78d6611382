"""What all tests share: ROS domains of their own, and no traffic beyond this host."""

from __future__ import annotations

import os
import socket
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

DOMAINS = range(1, 101)  # valid on every platform with the standard DDS port mapping
FIRST_LEASE_PORT = 32768  # of ROS's own domain_coordinator: whoever holds this port + domain uses that domain


@contextmanager
def leased_domain() -> Iterator[int]:
    """Lease a ROS domain that no other test on this host uses; the bound port is the lease."""
    for domain in DOMAINS:
        with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as lease:
            try:
                lease.bind(("127.0.0.1", FIRST_LEASE_PORT + domain))
            except OSError:
                continue
            yield domain
            return
    raise RuntimeError("all ROS domains from 1 to 100 are in use on this host; expected at least one free.")


def pytest_configure(config: pytest.Config) -> None:
    """Give the whole session a domain, for tests that ask for none."""
    lease = ExitStack()
    os.environ["ROS_DOMAIN_ID"] = str(lease.enter_context(leased_domain()))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    config.add_cleanup(lease.close)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Run a test, and the nodes that it starts, in a ROS domain of its own."""
    with leased_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain
