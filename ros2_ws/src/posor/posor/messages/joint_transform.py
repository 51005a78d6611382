# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Joint transforms (``posor_msgs/JointTransform``): packed from estimates, checked without decoding the messages."""

from __future__ import annotations

import math
import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from posor.chain.identity import NOT_STATED, calibration_id
from posor.chain.joint_measurements import JointRowLayout
from posor.errors import ShapeError, TopicError
from posor.estimation.estimate_scan import LOST
from posor.estimation.fault_model import EFFECT, JointCauses
from posor.messages.cdr_schema import LITTLE_ENDIAN, STAMP
from posor.messages.message_definitions import installed_schema
from posor.messages.message_table import LEAD, MessageRows, MessageTable, TableLayout
from posor.numerics.compiled import in_place, record_view
from posor.numerics.stamps import NS, time_ns
from posor.ros_names import JOINT_TRANSFORM

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.estimation.estimate import Estimates
    from posor.estimation.posor import Posor
    from posor.messages.cdr_schema import Schema
    from posor.numerics.array_types import FloatArray

FIELDS = {  # fields that an estimate fills, by their names in TRANSFORM_LAYOUT
    "stamp": "header.stamp.sec",
    "number": "scan",
    "status": "scan_status",
    "redundancy": "redundancy",  # one byte, followed by the state
    "faults": "faults",
    "pose": "pose.position.x",
    "native": "native",
    "residual": "residual",
    "covariance_random": "covariance_random",
    "covariance_systematic": "covariance_systematic",
    "shared_effects": "shared_effects",
    "stamp_shift": "stamp_shift",
    "effects": "effects",
}
TRANSFORM_LAYOUT = np.dtype([*((name, "i8") for name in FIELDS), ("shared_count", "i8"), ("effect_count", "i8")])
"""Byte offsets of the fields in a row of bytes, and the numbers of shared terms and of fault effects."""

NO_CAUSES = JointCauses()
_STAMP = struct.Struct("<iI")
_FAULTS = struct.Struct("<I")


class TransformConstants(NamedTuple):
    """What is the same in all transforms of a joint."""

    parent: str
    child: str
    shared: tuple[str, ...] = ()  # names of the shared terms
    causes: JointCauses = NO_CAUSES  # of faults, with their effects
    calibration: int = NOT_STATED  # ``calibration_id`` of that in force

    @staticmethod
    def of(posor: Posor) -> TransformConstants:
        """Return those of the transforms that a POSOR estimates."""
        calibration, causes = posor.calibration, posor.hypotheses.joint_causes()
        frames, shared = calibration.frames, tuple(calibration.shared)
        return TransformConstants(frames.parent, frames.child, shared, causes, calibration_id(calibration))

    def encoded(self, schema: Schema) -> bytes:
        """Return a message with these values; ``schema``: JointTransform."""
        values = {
            "header.frame_id": self.parent,
            "child_frame_id": self.child,
            "calibration": self.calibration,
            "shared_terms": list(self.shared),
            "shared_effects": [0.0] * (6 * len(self.shared)),
            "causes": list(self.causes.names),
            "effect_causes": list(self.causes.of_effects),
            "effect_kinds": list(self.causes.kinds),
            "effects": [0.0] * (EFFECT * len(self.causes.kinds)),
        }
        return schema.encode(values)

    def layout(self, schema: Schema) -> TableLayout:
        """Return the layout of the transforms; ``schema``: JointTransform."""
        return TableLayout.of(self.encoded(schema), schema)


def packing_layout(transforms: TableLayout) -> NDArray[np.void]:
    """Return the record of dtype TRANSFORM_LAYOUT, shape (1,), of messages with a layout."""
    layout = np.zeros(1, dtype=TRANSFORM_LAYOUT)
    for name, path in FIELDS.items():
        layout[name] = LEAD + transforms.offset(path)
    layout["shared_count"] = transforms.dtype["shared_effects"].shape[0] // 6
    layout["effect_count"] = transforms.dtype["effects"].shape[0] // EFFECT
    return layout


@in_place
def pack_estimate(
    estimate: Any, effects: NDArray[np.float32], layout: Any, template: FloatArray, rows: MessageRows, n: int
) -> None:
    """Write an estimate (record of dtype ESTIMATE) into row n, but for stamp, number and status of its scan.

    ``effects``: its fault effects, (C, EFFECT).
    """
    words, floats = rows.words, rows.floats
    for k in range(template.shape[0]):
        floats[n, k] = template[k]
    words[n, layout.redundancy // 4] = estimate.redundancy | estimate.state << 8
    words[n, layout.faults // 4] = estimate.faults
    for k in range(7):
        floats[n, layout.pose // 8 + k] = estimate.pose[k]
    for k in range(6):
        floats[n, layout.native // 8 + k] = estimate.native[k]
        floats[n, layout.stamp_shift // 8 + k] = estimate.stamp_shift[k]
    floats[n, layout.residual // 8] = math.nan if estimate.state == LOST else estimate.residual
    random, systematic = layout.covariance_random // 8, layout.covariance_systematic // 8
    for i in range(6):
        for j in range(6):
            floats[n, random + 6 * i + j] = estimate.random[i, j]
            floats[n, systematic + 6 * i + j] = estimate.systematic[i, j]
    for t in range(layout.shared_count):
        for i in range(6):
            floats[n, layout.shared_effects // 8 + 6 * t + i] = estimate.shared[t, i]
    first = layout.effects // 4
    for c in range(layout.effect_count):
        for k in range(EFFECT):
            rows.singles[n, first + EFFECT * c + k] = effects[c, k]


@in_place
def pack_rows(
    estimates: Any, effects: NDArray[np.float32], layout: Any, template: FloatArray, rows: MessageRows
) -> None:
    """Write each estimate (records of dtype ESTIMATE) into the row of the same index; see ``pack_estimate``."""
    for n in range(estimates.shape[0]):
        pack_estimate(estimates[n], effects[n], layout[0], template, rows, n)


def pack_joint_transforms(layout: TableLayout, estimates: Estimates) -> MessageTable:
    """Return a JointTransform message for each estimate.

    Raises ShapeError: the estimates have not as many fault effects as the layout.
    """
    table = MessageTable(layout, np.empty((len(estimates), len(layout.row)), dtype=np.uint8))
    records, packing = record_view(estimates._records), record_view(packing_layout(layout))
    effects, shape = estimates.fault_effects, (len(estimates), int(packing["effect_count"][0]), EFFECT)
    if effects.shape != shape:
        raise ShapeError("fault effects", received=effects.shape, expected=f"{shape}, as the layout has")
    effects = np.require(effects, requirements=["C", "W"])
    pack_rows(records, effects, packing, layout.row.view(np.float64), MessageRows.of(table.rows))
    table["header.stamp.sec"], table["header.stamp.nanosec"] = estimates.header_stamps.T
    table["scan"], table["scan_status"] = estimates.numbers, estimates.statuses
    return table


@lru_cache(maxsize=16)
def stamp_of(stamp_ns: int) -> bytes:
    """Return the serialised stamp of a time [ns], also of one before 1970."""
    return _STAMP.pack(*divmod(stamp_ns, NS))


def stamp_ns_of(stamp: bytes) -> int:
    """Return a serialised stamp, ``data[STAMP]``, in nanoseconds; 0 for an invalid stamp.

    Cached, because the messages of all joints for one scan have the same stamp.
    """
    return time_ns(*_STAMP.unpack(stamp))


class JointTransformFormat:
    """Format of the serialised transforms of a joint: where the numbers lie, and all bytes that do not change.

    Attributes:
        constants: What is the same in all transforms.
        size: Of a message [bytes]; surplus bytes at its end are ignored.
        row_layout: Offsets of the fields in a row that holds the message behind ``LEAD`` bytes.

    """

    def __init__(self, example: bytes) -> None:
        """Take the format of a message in plain CDR.

        Raises TopicError: invalid bytes, not six effects for each term, not seven for each of the effects of causes, or
        an unknown cause.
        """
        schema = installed_schema(JOINT_TRANSFORM)
        values, layout = schema.values(example), schema.layout(example)
        terms, of_effects, kinds = values["shared_terms"], values["effect_causes"], values["effect_kinds"]
        shared, effects, count = layout["shared_effects"], layout["effects"], len(of_effects)
        for name, found, wanted in (
            ("shared_effects", shared.length, 6 * len(terms)),
            ("effect_kinds", len(kinds), count),
            ("effects", effects.length, EFFECT * count),
        ):
            if found != wanted:
                raise TopicError(f"a message has {found} {name}", where=schema.name, expected=f"{wanted}")
        if count and max(of_effects) >= len(values["causes"]):
            what, expected = f"effect_causes has {max(of_effects)}", f"less than {len(values['causes'])}"
            raise TopicError(what, where=schema.name, expected=expected)
        causes = JointCauses(tuple(values["causes"]), tuple(of_effects), tuple(kinds))
        frames = values["header.frame_id"], values["child_frame_id"]
        self.constants = TransformConstants(*frames, tuple(terms), causes, values["calibration"])
        self.size = layout.size
        self.row_layout = JointRowLayout(
            pose=LEAD + layout["pose.position.x"].offset,
            native=LEAD + layout["native"].offset,
            covariance_random=LEAD + layout["covariance_random"].offset,
            covariance_systematic=LEAD + layout["covariance_systematic"].offset,
            shared=LEAD + shared.offset if terms else 0,
            effects=LEAD + effects.offset if count else 0,
            stamp_shift=LEAD + layout["stamp_shift"].offset,
            state=LEAD + layout["state"].offset,
            size=LEAD + layout.size,
            effect_count=count,
        )
        self._frames = example[STAMP.stop : layout["scan"].offset]
        self._begin_terms, self._begin_causes = layout["calibration"].offset, layout.lengths["causes"]
        end_of_terms = shared.offset if terms else layout.lengths["shared_effects"] + 4
        self._terms = example[self._begin_terms : end_of_terms]
        self._causes = example[self._begin_causes : effects.offset if count else layout.size]
        self._state, self._faults = layout["state"].offset, layout["faults"].offset

    def matches(self, data: bytes) -> bool:
        """Return whether a message is in plain CDR and has the constants of this format, in the same bytes.

        The padding after strings is arbitrary: a message with other padding does not match either.
        """
        return (
            len(data) >= self.size
            and data.startswith(self._frames, STAMP.stop)
            and data.startswith(self._terms, self._begin_terms)
            and data.startswith(self._causes, self._begin_causes)
            and data.startswith(LITTLE_ENDIAN)
        )

    def read_state(self, data: bytes | memoryview) -> tuple[int, int]:
        """Return ``State`` and ``Fault`` of a message as plain numbers."""
        return data[self._state], int(_FAULTS.unpack_from(data, self._faults)[0])
