# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Finds nodes of an arm that run in the ROS domain already, before and after its own are started.

Node names of ROS 2 need not be unique: a second arm of the same name would publish on the same topics.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Self

import rclpy
from posor.chain.arm_file import load_arm_file
from posor.claim import claim
from posor.errors import PosorError
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from types import TracebackType

DISCOVERY_S = 2.0
"""Time in which a new participant learns of the nodes of its domain; it runs while the files of the arm are read.

On a busy host it may take longer; ``refuse_second`` then finds the other arm after the start."""
END_S = 5.0
"""Time in which nodes that are listed may still end, as those of a bringup that was killed do."""
POLL_S = 0.02
ONE_ARM = "one arm of a name: end it, give this one another name, or set another ROS_DOMAIN_ID"


def enclave_of_arm(arm: str, namespace: str, process: str) -> str:
    """Return the identity of a process of an arm in a network with SROS 2, which the observer shares; else empty."""
    if os.environ.get("ROS_SECURITY_ENABLE") == "true":
        with suppress(PosorError):
            return f"{load_arm_file(arm).in_namespace(namespace).namespace}/{process}"
    return ""


class GraphObserver:
    """A hidden node that lists the nodes of its domain; leaving the ``with`` block removes it."""

    def __init__(self, enclave: str = "") -> None:
        """Join the domain; ``enclave``: identity in a network with SROS 2."""
        self._context = Context()
        arguments = ["--ros-args", "--enclave", enclave] if enclave else []
        rclpy.init(args=arguments, context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(
            f"_posor_bringup_{os.getpid()}",
            context=self._context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._discovered_s = time.monotonic() + DISCOVERY_S

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()

    def _names(self) -> Iterable[str]:
        return (f"{namespace.rstrip('/')}/{name}" for name, namespace in self._node.get_node_names_and_namespaces())

    def claim(self, namespace: str, frame: str = "") -> ExitStack:
        """Return the claims of an arm's namespace in this domain, and of its endpoint ``frame`` on ``/tf``, if any.

        The nodes of another arm are listed only seconds later. Raises PosorError: another process of this host has
        claimed the namespace or the frame.
        """
        domain = self._context.get_domain_id()
        what = f"another bringup starts, runs or ends it in ROS domain {domain}"
        refusals = {f"{domain}:{namespace}": PosorError(what, where=f"arm {namespace}", expected=ONE_ARM)}
        if frame:
            what = f"another bringup publishes it on /tf in ROS domain {domain}"
            expected = "one arm with this frame: give each a frame_prefix"
            refusals[f"{domain}:/tf:{frame}"] = PosorError(what, where=f"frame {frame}", expected=expected)
        with ExitStack() as stack:
            for name, refusal in refusals.items():
                stack.enter_context(claim(name, refusal))
            return stack.pop_all()

    def refuse_running(self, names: Sequence[str]) -> None:
        """Raise a PosorError if a node with one of the full names runs and does not end within ``END_S``.

        Waits until the domain has been discovered.
        """
        time.sleep(max(0.0, self._discovered_s - time.monotonic()))
        end_s = time.monotonic() + END_S
        while running := set(names).intersection(self._names()):
            if time.monotonic() >= end_s:
                self._refuse(running)
            time.sleep(POLL_S)

    def refuse_second(self, names: Sequence[str]) -> None:
        """Raise a PosorError if two nodes have one of the full names: one of them is not of this arm."""
        count = Counter(self._names())
        self._refuse({name for name in names if count[name] > 1})

    def _refuse(self, running: set[str]) -> None:
        if running:
            domain = self._context.get_domain_id()
            raise PosorError(
                f"already runs in ROS domain {domain}, with {len(running)} of the nodes to be started",
                where=f"node {min(running)}",
                expected=f"{ONE_ARM}; nodes that were killed are listed for up to 20 s",
            )
