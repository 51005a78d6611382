# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import socket

import pytest
from posor.errors import PosorError
from posor_lab.harness import ros_domain
from posor_lab.harness.ros_domain import isolated_network, leased_domain


def test_two_leases_never_share_a_domain_or_the_port_of_the_domain_coordinator() -> None:
    with leased_domain() as first, leased_domain() as second, socket.socket() as other:
        assert first != second
        assert {first, second} <= set(ros_domain.DOMAINS)
        with pytest.raises(OSError, match="in use"):
            other.bind(("127.0.0.1", ros_domain.FIRST_LEASE_PORT + first))


def test_an_exhausted_range_is_an_error_until_a_domain_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    with leased_domain() as taken:
        monkeypatch.setattr(ros_domain, "DOMAINS", range(taken, taken + 1))
        with pytest.raises(PosorError, match="all ROS domains"), leased_domain():
            pass
    with leased_domain() as again:
        assert again == taken


def test_the_network_is_isolated_unless_the_user_has_chosen_a_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    with isolated_network():
        assert os.environ["ROS_DOMAIN_ID"] == "77"
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    monkeypatch.delenv("ROS_DOMAIN_ID")
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    with isolated_network():
        assert int(os.environ["ROS_DOMAIN_ID"]) in ros_domain.DOMAINS
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert "ROS_DOMAIN_ID" not in os.environ
