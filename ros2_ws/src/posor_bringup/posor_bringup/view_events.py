# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Causes for which an arm is not sound, and a bounded log of them: when, which joints, what, how long.

The reason of every ``endpoint/state`` becomes causes, each with the joints that it concerns. A cause that returns
within ``MERGE_S`` after its end continues its event, so that a fault of single scans does not fill the log.
"""

from __future__ import annotations

import csv
import io
import re
from collections import OrderedDict
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

from posor.numerics.stamps import NS
from posor.reporting.fault_texts import FAULT_TEXTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

MERGE_S = 2.0  # pause of a cause within one event
EVENTS = 2000  # kept; the oldest are left out first
OK, NOTE, WARNING, DEGRADED, STALE = "OK", "NOTE", "WARNING", "DEGRADED", "STALE"
SEVERITY = {
    name: number
    for number, name in enumerate(
        (OK, NOTE, "NO STATE", WARNING, DEGRADED, "NO MESSAGE", "UNCOUNTED", "LOST", "SILENT", STALE)
    )
}
"""States from sound to unusable; unknown states are worse."""
_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")
_FAULTS = re.compile(r"(?:is \w+ )?\(?([A-Z_]+(?:\|[A-Z_]+)*)\)?")
_REASONS = re.compile("; (?!expected )")  # what was expected belongs to the reason before
_DEGRADED_JOINT = re.compile(r"(\w+)((?: \([^)]*\))?)(?:, |$)")


def severity(state: str) -> int:
    """Return the place of a state in ``SEVERITY``."""
    return SEVERITY.get(state, len(SEVERITY))


class Cause(NamedTuple):
    """Why an arm is not sound."""

    state: str  # of the joints, or of the endpoint
    text: str  # what is wrong, without the names of joints
    joints: tuple[str, ...] = ()  # that it concerns; empty: the whole arm

    @property
    def key(self) -> tuple[str, str]:
        """Equal for causes that differ in their joints and numbers only."""
        return self.state, _NUMBER.sub("#", self.text)


def merge_causes(causes: Iterable[Cause]) -> list[Cause]:
    """Return causes with equal keys as one, which has the text of the first and the joints of all."""
    merged: dict[tuple[str, str], Cause] = {}
    for cause in causes:
        first = merged.setdefault(cause.key, cause)
        merged[cause.key] = first._replace(joints=tuple(dict.fromkeys((*first.joints, *cause.joints))))
    return list(merged.values())


def causes_of_state(state: str, reason: str, joint: str, joints: Sequence[str]) -> list[Cause]:
    """Return the causes that an ``endpoint/state`` names.

    ``joint``: that the state is about; ``joints``: names of all joints of the arm.
    """
    if state == OK:
        return []
    found = []
    for part in _REASONS.split(reason):
        if part.startswith("degraded: "):
            pairs = _DEGRADED_JOINT.findall(part.removeprefix("degraded: "))
            found += [Cause(state, _in_words(faults.strip()) or "degraded", (name,)) for name, faults in pairs]
            continue
        names = tuple(name for name in re.findall(r"\w+", part) if name in joints)
        text = part.removeprefix("each of ").strip()
        for name in names:
            text = text.removeprefix(name).lstrip(",: ")
        found.append(Cause(state, _in_words(text) or part, tuple(dict.fromkeys(names))))
    if joint and not any(cause.joints for cause in found):
        found = [cause._replace(joints=(joint,)) for cause in found]
    return merge_causes(found)


def _in_words(text: str) -> str:
    """Return a text that only names faults in words, with the names in parentheses; any other unchanged."""
    if (match := _FAULTS.fullmatch(text)) is None:
        return text.removeprefix("is ")
    names = match[1].split("|")
    return f"{', '.join(FAULT_TEXTS.get(name, name) for name in names)} ({', '.join(names)})"


@dataclass(frozen=True)
class Event:
    """A cause and its time."""

    cause: Cause  # with all joints that it has concerned
    begin_ns: int  # first scan with the cause
    end_ns: int | None = None  # first scan without; None: the cause is present
    count: int = 1  # how often it has begun
    newest_ns: int = 0  # when it has begun last

    def lasted_s(self, now_ns: int) -> float:
        """Return the time from begin to end, or until now [s]."""
        return max(0, (now_ns if self.end_ns is None else self.end_ns) - self.begin_ns) / NS


class EventLog:
    """Events in the order of their begin, the newest ``EVENTS`` of them; those of present causes before others.

    Attributes:
        left_out: Number of older events.

    """

    def __init__(self) -> None:
        self._events: OrderedDict[int, Event] = OrderedDict()
        self._latest: dict[tuple[str, tuple[str, str]], int] = {}  # number of the newest event of a source and key
        self._present: dict[str, dict[tuple[str, str], Cause]] = {}  # causes of each source now
        self._count = self.left_out = 0

    def update(self, source: str, now_ns: int, causes: Iterable[Cause]) -> None:
        """Open and close events; ``causes``: all that are present at a time by one source, with different keys."""
        present, before = {cause.key: cause for cause in causes}, self._present.get(source, {})
        for key in before.keys() - present.keys():
            number = self._latest[source, key]
            self._events[number] = replace(self._events[number], end_ns=now_ns)
        for key, cause in present.items():
            if before.get(key) == cause:
                continue
            event = self._events.get(self._latest.get((source, key), -1))
            if event is None or (event.end_ns is not None and not 0 <= now_ns - event.end_ns <= MERGE_S * NS):
                self._add(source, Event(cause, now_ns, newest_ns=now_ns))
            else:
                both = merge_causes([event.cause, cause])[0]
                if event.end_ns is not None:
                    event = replace(event, count=event.count + 1, newest_ns=now_ns)
                self._events[self._latest[source, key]] = replace(event, cause=both, end_ns=None)
        self._present[source] = present

    def note(self, now_ns: int, text: str) -> None:
        """Add an event without duration."""
        self._add("note", Event(Cause(NOTE, text), now_ns, now_ns))

    def _add(self, source: str, event: Event) -> None:
        self._count += 1
        self._events[self._count] = event
        self._latest[source, event.cause.key] = self._count
        if len(self._events) > EVENTS and (ended := [n for n, each in self._events.items() if each.end_ns is not None]):
            del self._events[ended[0]]
            self.left_out += 1
            self._latest = {key: number for key, number in self._latest.items() if number != ended[0]}

    def begin_ns(self, cause: Cause, time_ns: int) -> int:
        """Return when a cause that is present at a time has begun last [ns]."""
        for event in self.events():
            if event.begin_ns <= time_ns and event.cause.key == cause.key:
                return event.newest_ns if event.newest_ns <= time_ns else event.begin_ns
        return time_ns

    def events(self) -> Iterator[Event]:
        """Yield the events, the newest first."""
        return reversed(self._events.values())

    def to_csv(self, now_ns: int) -> bytes:
        """Return the events as a table; the oldest first."""
        out = io.StringIO()
        writer = csv.writer(out)
        writer.writerow(("begin_utc", "end_utc", "duration_s", "times", "state", "joints", "what"))
        if self.left_out:
            writer.writerow(("", "", "", self.left_out, NOTE, "", "older events are left out"))
        for event in self._events.values():
            end = "" if event.end_ns is None else utc(event.end_ns)
            cause, duration = event.cause, f"{event.lasted_s(now_ns):.3f}"
            writer.writerow(
                (utc(event.begin_ns), end, duration, event.count, cause.state, " ".join(cause.joints), cause.text)
            )
        return out.getvalue().encode()


def utc(time_ns: int, form: str = "%Y-%m-%dT%H:%M:%S.%f") -> str:
    """Return a time [ns] in UTC; microseconds are cut to milliseconds."""
    text = datetime.fromtimestamp(time_ns // NS, UTC).replace(microsecond=time_ns % NS // 1000).strftime(form)
    return text[:-3] if form.endswith("%f") else text


def duration_text(seconds: float) -> str:
    """Return a duration with two units at most, such as ``3 min 20 s``."""
    if seconds < 60.0:  # noqa: PLR2004  a minute
        return f"{seconds:.1f} s"
    rest, parts = int(seconds), list[str]()
    for unit, size in (("d", 86400), ("h", 3600), ("min", 60), ("s", 1)):
        count, rest = divmod(rest, size)
        if count or parts:
            parts.append(f"{count} {unit}")
    return " ".join(parts[:2])
