# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The parameters ``qos_overrides.*`` of a node, by which a user changes the quality of service of one topic.

They have the standard names, ``qos_overrides.<topic>.<publisher or subscription>.<history, depth or reliability>``.
rclpy declares and applies them when a publisher or subscription is created; it ignores one that fits none of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from posor.errors import ParameterError, similar_name
from rclpy.qos import HistoryPolicy, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

PREFIX = "qos_overrides."
CHOICES = {
    "history": [HistoryPolicy.KEEP_LAST.name.lower(), HistoryPolicy.KEEP_ALL.name.lower()],
    "reliability": [ReliabilityPolicy.RELIABLE.name.lower(), ReliabilityPolicy.BEST_EFFORT.name.lower()],
}
"""Values of the policies other than ``depth``, as rclpy spells them."""
MAX_DEPTH = 100_000


class QosOverrides:
    """The user's overrides of one node, and the topics that they may name."""

    def __init__(self, node: str, values: Mapping[str, object]) -> None:
        """Check the user's values by the name of the parameter. Raises ParameterError: a value is wrong."""
        self._node = node
        self._names = list(values)
        self._possible: set[str] = set()
        for name, value in values.items():
            self._check_value(name, value)

    def options(self, kind: Literal["publisher", "subscription"], topic: str) -> QoSOverridingOptions:
        """Return the options for rclpy to create the publisher or subscription of a topic, given by its full name."""
        self._possible |= {f"{PREFIX}{topic}.{kind}.{policy}" for policy in ("depth", *CHOICES)}
        return QoSOverridingOptions.with_default_policies()

    def check_names(self) -> None:
        """Raise a ParameterError if an override names no topic that the node has by now."""
        for name in self._names:
            if name not in self._possible:
                raise ParameterError(
                    f"'{name}': this node has no such topic, direction or policy",
                    where=f"node {self._node}",
                    expected=similar_name(
                        name, sorted(self._possible), f"'{PREFIX}<topic>.<publisher|subscription>.<policy>'"
                    ),
                )

    def _check_value(self, name: str, value: object) -> None:
        policy = name.rsplit(".", 1)[-1]
        if policy == "depth":
            is_valid = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MAX_DEPTH
            expected = f"an integer at least 1 and at most {MAX_DEPTH}"
        else:
            choices = CHOICES.get(policy)
            is_valid = choices is None or value in choices  # ``check_names`` refuses other policies
            expected = " or ".join(choices or [])
        if not is_valid:
            what = f"'{name}' is {value!r}"
            raise ParameterError(what, where=f"node {self._node}", expected=expected, parameter=name)
