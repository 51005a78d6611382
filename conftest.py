"""What all tests share: ROS domains of their own, no traffic beyond this host, and a middleware that is not patient."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from posor_estimator.ros.domain import leased_domain

if TYPE_CHECKING:
    from collections.abc import Iterator


PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""What Fast DDS reads; without it a graph takes up to 3 s longer to begin, and to end."""


def pytest_configure(config: pytest.Config) -> None:
    """Give the whole session a domain, for tests that ask for none."""
    lease = ExitStack()
    os.environ["ROS_DOMAIN_ID"] = str(lease.enter_context(leased_domain()))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault(PROFILES, str(Path(__file__).with_name("tests") / "fastdds.xml"))
    config.add_cleanup(lease.close)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Run a test, and the nodes that it starts, in a ROS domain of its own."""
    with leased_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain
