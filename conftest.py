# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of all tests: a separate ROS domain, no traffic beyond this host, and short timeouts of the middleware."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from posor.lazy_program import handle_interrupts
from posor_lab.harness.ros_domain import leased_domain

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Names the file with the settings of Fast DDS. Without them a graph takes up to 3 s longer to start and to end."""


def pytest_configure(config: pytest.Config) -> None:
    """Lease a ROS domain for the session, used by tests without the ``ros_domain`` fixture."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # of the programs that tests start; pytest may run under nohup
    handle_interrupts()  # likewise, because pytest may run in the background of a script
    lease = ExitStack()
    os.environ["ROS_DOMAIN_ID"] = str(lease.enter_context(leased_domain()))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault(PROFILES, str(Path(__file__).with_name("tests") / "fastdds.xml"))
    config.add_cleanup(lease.close)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Run a test and the nodes that it starts in a separate ROS domain."""
    with leased_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain
