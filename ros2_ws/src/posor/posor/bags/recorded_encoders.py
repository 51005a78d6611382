# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of encoders from a bag: the positions and efforts of named joints on a topic of JointState."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from posor.bags.bag_reader import checked_type, opened_bag
from posor.bags.block_reader import read_blocks
from posor.bags.message_block import TopicReader
from posor.bags.recording import Track
from posor.errors import BagError
from posor.messages.message_definitions import schema_of_topic
from posor.messages.message_table import LEAD
from posor.numerics.stamps import NS, times_ns
from posor.ros_names import JOINT_STATE, JOINT_STATES_TOPIC

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from posor.messages.message_table import MessageTable
    from posor.numerics.array_types import FloatArray, IntArray

LONGEST_GAP_S = 0.05  # between two readings, for an angle between them


class RecordedEncoders(NamedTuple):
    """Readings of the encoders of j joints in n messages; NaN: not in a message."""

    stamps_ns: IntArray  # (n,)
    positions: FloatArray  # [rad], (n, j)
    efforts: FloatArray  # [N m] or [N], (n, j)
    source: str  # bag and topic

    def at(self, joint: int, stamps_ns: IntArray) -> FloatArray:
        """Return position and effort of a joint at times, (m, 2); NaN: too far from any reading.

        Positions lie on a cubic spline: between readings 40 ms apart, a straight line is wrong by the acceleration
        times 0.2 ms². Efforts lie on straight lines.
        Readings without an effort are left out where others have one; where none has one, it is zero.

        Raises TrackError: the stamps of its readings do not increase.
        """
        known, has_effort = np.isfinite(self.positions[:, joint]), np.isfinite(self.efforts[:, joint])
        if has_effort.any():
            known &= has_effort
        values = np.column_stack([self.positions[:, joint], np.nan_to_num(self.efforts[:, joint])])[known]
        track = Track(self.stamps_ns[known], values, np.zeros(2), self.source)
        found = track.interpolate(stamps_ns, round(LONGEST_GAP_S * NS))
        between = np.isfinite(found[:, 0])
        if len(track.stamps_ns) > 1:
            times_s = (track.stamps_ns - track.stamps_ns[0]) / NS
            found[between, 0] = CubicSpline(times_s, values[:, 0])((stamps_ns[between] - track.stamps_ns[0]) / NS)
        return found


def read_encoders(bag: Path, topic: str, names: Sequence[str], namespace: str) -> RecordedEncoders:
    """Return the readings of a topic for joints of these names.

    ``namespace``: of the arm. Raises BagError: the bag cannot be read, the topic is missing or of another type or holds
    the angles by the arm's POSORs, a stamp is invalid, or a joint has no reading, or its readings are mostly more than
    LONGEST_GAP_S apart.
    """
    where = f"{bag}, topic {topic}"
    if topic == f"{namespace}/{JOINT_STATES_TOPIC}":
        raise BagError("holds the angles that the POSORs have measured", where=where, expected="readings of encoders")
    parts = []
    with opened_bag(bag) as reader:
        connections = list(reader.connections)
        checked_type(connections, topic, str(bag), None, (JOINT_STATE,), filled=True)
        schema = schema_of_topic(connections, topic, str(bag))
        tables = TopicReader(0, topic, schema, str(bag))
        for block in read_blocks(reader, [topic], str(bag)):
            for _, _, table in tables.read_tables(block):
                size = schema.layout(table.messages[0].tobytes()).lengths["position"]
                # Messages of one layout may have other names of the same lengths.
                texts, which = np.unique(table.rows[:, LEAD + 12 : LEAD + size], axis=0, return_inverse=True)
                for n in range(len(texts)):
                    own = table.select(np.flatnonzero(which == n))
                    found = list(schema.values(own.messages[0].tobytes())["name"])
                    if repeated := sorted({name for name in found if found.count(name) > 1}):
                        raise BagError(f"names {', '.join(repeated)} more than once", where=where, expected="once each")
                    if (count := own["position"].shape[1]) not in (0, len(found)):
                        what = f"{count} positions of {len(found)} names"
                        raise BagError(what, where=where, expected="a position of each name")
                    parts.append(
                        (_stamps(own), *(_columns(own, field, found, names) for field in ("position", "effort")))
                    )
    stamps_ns, positions, efforts = map(np.concatenate, zip(*parts, strict=True))
    order = np.argsort(stamps_ns, kind="stable")
    if not stamps_ns.all():
        raise BagError("a stamp is zero or invalid", where=where, expected="the time of each reading")
    missing = [name for name, column in zip(names, positions.T, strict=True) if not np.isfinite(column).any()]
    if missing:
        raise BagError(f"no reading of {', '.join(missing)}", where=where, expected="one of each joint")
    encoders = RecordedEncoders(stamps_ns[order], positions[order], efforts[order], where)
    _check_gaps(encoders, names)
    return encoders


def _check_gaps(encoders: RecordedEncoders, names: Sequence[str]) -> None:
    for name, column in zip(names, encoders.positions.T, strict=True):
        gaps = np.diff(encoders.stamps_ns[np.isfinite(column)])
        if gaps.size and (usual := float(np.median(gaps)) / NS) > LONGEST_GAP_S:
            what, expected = f"readings of {name} are {usual:.6g} s apart", f"at most {LONGEST_GAP_S:g} s"
            raise BagError(what, where=encoders.source, expected=expected)


def _stamps(table: MessageTable) -> IntArray:
    return times_ns(table["header.stamp.sec"].astype(np.int64), table["header.stamp.nanosec"].astype(np.int64))


def _columns(table: MessageTable, field: str, found: Sequence[str], names: Sequence[str]) -> FloatArray:
    """Return a field of the joints in ``names`` from messages whose joints are ``found``, (n, j)."""
    out = np.full((len(table), len(names)), np.nan)
    numbers = table[field]
    for j, name in enumerate(names):
        if name in found and found.index(name) < numbers.shape[1]:
            out[:, j] = numbers[:, found.index(name)]
    return out
