# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arms of one name in one domain: nodes that run already are refused, and a namespace is claimed by one bringup."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import posor_bringup.graph_observer as module
import pytest
import rclpy
from posor.errors import PosorError
from posor_bringup.graph_observer import GraphObserver
from posor_lab.harness.case_tables import refusal
from rclpy.context import Context
from rclpy.node import Node

pytestmark = pytest.mark.usefixtures("ros_domain")


@contextmanager
def node_by_hand(name: str, namespace: str) -> Iterator[None]:
    context = Context()
    rclpy.init(context=context)
    node = Node(name, namespace=namespace, context=context)
    yield
    node.destroy_node()
    context.try_shutdown()


def is_refused(check: Callable[[], None]) -> bool:
    try:
        check()
    except PosorError:
        return True
    return False


@pytest.mark.parametrize("namespace", ["/arm", ""])
def test_a_node_by_hand_is_refused_before_and_after_the_start(namespace: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "END_S", 0.1)
    names = [f"{namespace}/chain_node", f"{namespace}/joint1/posor_node"]
    with GraphObserver() as graph, node_by_hand("chain_node", namespace):
        error = refusal(PosorError, graph.refuse_running, names)
        assert (error.where, error.what.count("with 1 of the nodes")) == (f"node {namespace}/chain_node", 1)
        graph.refuse_running(names[1:])
        graph.refuse_second(names)
        with node_by_hand("chain_node", namespace):
            while not is_refused(lambda: graph.refuse_second(names)):
                pass  # until both nodes are known


def test_a_namespace_is_claimed_by_one_bringup_of_a_domain(ros_domain: int) -> None:
    with GraphObserver() as graph:
        with graph.claim("/arm"):
            assert str(refusal(PosorError, graph.claim, "/arm")) == (
                f"arm /arm: another bringup starts, runs or ends it in ROS domain {ros_domain}; expected one arm of a "
                "name: end it, give this one another name, or set another ROS_DOMAIN_ID."
            )
            graph.claim("/arm/b").close()
        graph.claim("/arm").close()


def test_a_frame_is_published_by_one_bringup_of_a_domain(ros_domain: int) -> None:
    with GraphObserver() as graph, graph.claim("/cell1/arm", "endpoint"):
        assert str(refusal(PosorError, graph.claim, "/cell2/arm", "endpoint")) == (
            f"frame endpoint: another bringup publishes it on /tf in ROS domain {ros_domain}; expected one arm with "
            "this frame: give each a frame_prefix."
        )
        graph.claim("/cell2/arm", "cell2/endpoint").close()  # the refusal has left no claim of the namespace
