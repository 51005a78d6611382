# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Freshness of a node's inputs: silence, number of publishers, age of stamps, order of scan numbers.

Silence is measured by the steady clock, the age of a stamp by the ROS clock. A node reports all of it in its status
line ``input``.
"""

from __future__ import annotations

import math
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.numerics.stamps import NS, is_accepted_age

from posor_ros.diagnostics import Level
from posor_ros.input_watch import InputWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor.node_parameters import FreshnessParameters

    from posor_ros.intra_process import IntraProcessSubscription
    from posor_ros.lifecycle_node import PosorNode

PUBLISHER_GONE_S = 0.2  # time after a second publisher has gone in which its last messages may still arrive [s]
INPUT_STATUS = "input"  # name of the status line
INACTIVE = "the node is not active"
MISSING, REPEATED, BACKWARD = "numbers_missing", "scans_repeated", "numbers_backward"
"""Kinds of scans out of order, as the diagnostics count them."""


class StampLimits(NamedTuple):
    """Ages of stamps that a node accepts."""

    now_ns: Callable[[], int]  # the node's ROS time [ns]
    parameters: FreshnessParameters  # the limits
    youngest_ns: float  # least age [ns]; negative: ahead of ROS time
    oldest_ns: float  # greatest age [ns]

    @classmethod
    def of(cls, now_ns: Callable[[], int], parameters: FreshnessParameters) -> StampLimits:
        """Return the limits of a node."""
        return cls(now_ns, parameters, -parameters.max_future * NS, parameters.max_age * NS)

    def fault(self, stamp_ns: int) -> str:
        """Return the sentence on a stamp [ns] that is too old or too far ahead; else empty."""
        age_ns = self.now_ns() - stamp_ns
        accepted = is_accepted_age(age_ns, self.youngest_ns, self.oldest_ns)
        return "" if accepted else self._sentence(age_ns, stamp_ns)

    def _sentence(self, age_ns: int, stamp_ns: int) -> str:
        if age_ns + stamp_ns == 0:
            return "there is no ROS time yet to compare the stamp with; expected messages on /clock"
        limits = self.parameters
        side, limit, name = (
            ("old", limits.max_age, "max_age") if age_ns > 0 else ("ahead of ROS time", limits.max_future, "max_future")
        )
        return (
            f"the stamp is {abs(age_ns) / NS:.6g} s {side}; expected at most {limit:g} s, "
            f"or the parameter 'freshness.{name}' .inf for a recording"
        )


class ScanOrder:
    """Order of scan numbers: ``counts`` missing, repeated and backward numbers by name, for the diagnostics."""

    def __init__(self) -> None:
        self.counts = {MISSING: 0, REPEATED: 0, BACKWARD: 0}

    def describe(self, identity: tuple[int, int], last: tuple[int, int], *, is_same: bool) -> tuple[str, str]:
        """Count a scan that is not newer than the one before, by stamp [ns] and number of both.

        ``is_same``: whether both are the same message. Return the kind and the sentence, both empty for a newer scan. A
        repeated scan is to be dropped.
        """
        number, last_number = identity[1], last[1]
        if is_same:
            self.counts[REPEATED] += 1
            return REPEATED, f"scan {number} was repeated"
        if number <= last_number:
            self.counts[BACKWARD] += 1
            how = "again with other readings" if identity == last else f"after scan {last_number}"
            return BACKWARD, f"scan {number} came {how}"
        return "", ""

    def count_missing(self, number: int, missing: int) -> tuple[str, str]:
        """Count the scans that are missing before the scan of a number; return the kind and the sentence.

        ``missing``: difference of two numbers of 64 bits, less one; negative: beyond the half of their range.
        """
        missing %= 1 << 64
        self.counts[MISSING] += missing
        return MISSING, f"scans missing before scan {number}: {missing}"


class InputMonitor:
    """Watches all inputs of an active node, and the publishers of its result, and reports them in the status ``input``.

    Attributes:
        several: Error text while a topic has several publishers, updated with a delay; ``refusal`` is up to date.
        silent: Sentence on silent inputs, or that they are not read; empty: all arrive.
        silent_names: Their names.
        stamp_limits: Ages of stamps that the node accepts.

    """

    def __init__(self, node: PosorNode[Any], on_check: Callable[[bool], None] = lambda _: None) -> None:
        """Create the status line.

        ``on_check`` is called after each check (``INPUT_CHECK_S``) with whether the report has changed, or is repeated
        after another second.
        """
        self._node = node
        self._on_check = on_check
        self._status = node.diagnostics.add_status(INPUT_STATUS)
        self._watches: list[InputWatch] = []
        self._subscriptions: list[IntraProcessSubscription] = []
        self._outputs: dict[str, int] = {}  # publishers by topic
        self._is_active = False
        self._notes: dict[str, str] = {}
        self._notes_of_this_second: dict[str, str] = {}
        self._reported: tuple[str, ...] | None = None
        self.several, self._several_until_s = "", math.inf
        self.stamp_limits = StampLimits.of(node.timing.now_ns, node.parameters.freshness)
        self.silent_names: list[str] = []
        self.silent = INACTIVE
        node.diagnostics.add_refresh(self._refresh)
        node.add_graph_check(self._find_publishers)
        node.add_input_check(self.check)

    def add(self, subscription: IntraProcessSubscription) -> None:
        """Watch a subscription until ``clear``."""
        subscription.on_publishers = self._find_several
        self._subscriptions.append(subscription)
        self._watches.append(subscription.watch)
        self._find_several()

    def add_output(self, topic_name: str) -> None:
        """Watch until ``clear`` that a topic, by its full name, has no publisher but this node."""
        self._outputs[topic_name] = 1

    @property
    def output_fault(self) -> str:
        """Sentence on a topic of ``add_output`` that has several publishers; else empty."""
        return _several_sentence(self._outputs)

    def add_source(self, name: str) -> InputWatch:
        """Watch an input without a subscription until ``clear``; the caller records the arrivals."""
        watch = InputWatch(name)
        self._watches.append(watch)
        return watch

    def clear(self) -> None:
        """Stop watching all inputs."""
        self.stop()
        self._watches, self._subscriptions, self._outputs = [], [], {}
        self.several = ""

    def start(self) -> None:
        """Expect input with present stamps from now on."""
        self.stamp_limits = StampLimits.of(self._node.timing.now_ns, self._node.parameters.freshness)
        for watch in self._watches:
            watch.restart(monotonic())
        self._notes, self._notes_of_this_second = {}, {}
        self.silent, self._is_active = "", True

    def stop(self) -> None:
        """Expect no input any more."""
        self.silent, self._is_active = INACTIVE, False
        self._report(Level.OK, "not watched", None)

    def note(self, kind: str, text: str) -> None:
        """Report an anomaly, such as a missing scan, as a warning, until there was none of its kind for a second.

        The first of a kind is reported at once, the last one of each second with the status lines of that second:
        otherwise each node would publish diagnostics at the highest rate on an overloaded host.
        """
        self._notes_of_this_second[kind] = text
        if kind not in self._notes:
            self._notes[kind] = text
            self._report_notes()

    def update(self, counts: dict[str, int]) -> None:
        """Update values of the status line."""
        self._status.update(counts)

    def check(self) -> None:
        """Check all inputs, report a fault that has changed, and call ``on_check``."""
        if not self._is_active:
            return
        now_s, limit_s = monotonic(), self._node.parameters.freshness.max_silence
        several = self._several_publishers()
        silent = [(watch.name, text) for watch in self._watches if (text := watch.silence(now_s, limit_s))]
        self.silent, self.silent_names = "; ".join(text for _, text in silent), [name for name, _ in silent]
        key = (several, *self.silent_names) if several or silent else ()
        is_new = key != self._reported and (bool(key) or not self._notes)
        if is_new:
            text = "; ".join(filter(None, (several, self.silent)))
            self._report(Level.ERROR if key else Level.OK, text or "in time", key)
        self._on_check(is_new)

    def accepts(self, stamp_ns: int) -> bool:
        """Return whether ``refusal`` of a stamp [ns] is certainly empty; takes a fraction of its time."""
        limits = self.stamp_limits
        age_ns = limits.now_ns() - stamp_ns
        return not self.several and is_accepted_age(age_ns, limits.youngest_ns, limits.oldest_ns)

    def refusal(self, stamp_ns: int) -> str:
        """Return why a message with a stamp [ns] must not be used: several publishers, or the stamp; else empty."""
        return self._several_publishers() or self.stamp_limits.fault(stamp_ns)

    def _find_publishers(self) -> None:
        if self._is_active:
            for each in self._subscriptions:
                each.find_publishers()
            with (handle := self._node.handle):  # ``Node.count_publishers`` would parse the full name each time
                counts = {topic: int(handle.get_count_publishers(topic)) for topic in self._outputs}
            if counts != self._outputs:
                self._outputs = counts
                self._find_several()

    def _find_several(self) -> None:
        """Keep the sentence on several publishers of a topic until shortly after only one of them is left."""
        counts = {each.topic_name: each.publishers for each in self._subscriptions} | self._outputs
        if sentence := _several_sentence(counts):
            self.several, self._several_until_s = sentence, math.inf
        elif self.several:
            self._several_until_s = min(self._several_until_s, monotonic() + PUBLISHER_GONE_S)

    def _several_publishers(self) -> str:
        """Return the sentence on a topic that has or just had several publishers; else empty."""
        if self.several and monotonic() > self._several_until_s:
            self.several = ""
        return self.several

    def _refresh(self) -> None:
        """Report again: the anomalies of the last second, or the inputs with present ages."""
        self._notes, self._notes_of_this_second = self._notes_of_this_second, {}
        self._reported = None
        if self._notes:
            self._report_notes()
        self.check()

    def _report_notes(self) -> None:
        self._report(Level.WARN, "; ".join(self._notes.values()), None)

    def _report(self, level: Level, text: str, key: tuple[str, ...] | None) -> None:
        self._reported = key
        self._status.report(level, text)


def _several_sentence(publishers: Mapping[str, int]) -> str:
    """Return the sentence on the last topic that has several publishers; else empty."""
    sentences = [f"{count} publishers on {topic}; expected one" for topic, count in publishers.items() if count > 1]
    return sentences[-1] if sentences else ""
