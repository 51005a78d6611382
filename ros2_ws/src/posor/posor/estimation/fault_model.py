# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Hypotheses of faults as the kernels read them: columns in the space of the linearised readings.

A hypothesis has one or two parameters, each a column: what each of the m readings does per unit of the parameter. The
entries are constant coefficients times a sensitivity of the reading at the scan (``estimation.fault_effects``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.numerics.compiled import record_view

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray

LENGTH, VOLTAGE, GAIN, SUPPLY, TEMPERATURE, CONTACT_X, CONTACT_Y, AMBIENT = range(8)
SENSITIVITIES = 8
"""Sensitivities of a reading: 1, to its voltage [m/V], to its relative change [m], to the measured supply [m/V] and
temperature [m/K], to the relative change of a contact current of either axis [m], to ambient light [m]."""
EFFECT = 7  # numbers of a column: change of the pose in ROS order [m], [rad], and its cut
MAX_EFFECTS = 320  # bound of the columns of ``posor_msgs/JointTransform``

ALWAYS, SECOND, SHARED = 1, 2, 4
"""Flags of a column: its cause is always there; it is the second parameter of the hypothesis whose first parameter is
the column before; its cause is shared by the joints of the arm."""

COLUMN = np.dtype(
    [
        ("sensitivity", "i8"),
        ("first", "i8"),  # reading with an entry, and the one behind the last
        ("end", "i8"),
        ("bound", "f8"),  # largest size; infinite: unlimited
        ("kind", "i8"),  # sum of the flags above
    ],
    align=True,
)


class FaultModel(NamedTuple):
    """Hypotheses for the kernels, and their memory: C columns, m readings, r of them redundant."""

    columns: NDArray[np.void]  # shape (C,), dtype COLUMN
    coefficients: FloatArray  # of the entries, shape (C, m)
    entries: FloatArray  # scratch: the columns at a scan, shape (C, m)
    sensitivities: FloatArray  # scratch, shape (m, SENSITIVITIES)
    parity: FloatArray  # scratch: directions of the residual test, whitened, shape (r, m)
    components: FloatArray  # scratch: the columns in them, shape (C, r)
    shifts: FloatArray  # scratch: change of the pose per unit, ROS order, shape (C, 6)

    @staticmethod
    def of(columns: Sequence[tuple[tuple[int, FloatArray], float, int]], readings: int) -> FaultModel:
        """Allocate for columns (sensitivity and coefficients, bound, kind)."""
        count, redundant = len(columns), max(readings - 6, 0)
        records = np.zeros(count, dtype=COLUMN)
        coefficients = np.zeros((count, readings))
        for record, own, ((sensitivity, entries), bound, kind) in zip(records, coefficients, columns, strict=True):
            own[:], used = entries, np.flatnonzero(entries)
            record["sensitivity"], record["bound"], record["kind"] = sensitivity, bound, kind
            record["first"], record["end"] = used[0], used[-1] + 1
        return FaultModel(
            record_view(records),
            coefficients,
            np.zeros((count, readings)),
            np.zeros((readings, SENSITIVITIES)),
            np.zeros((redundant, readings)),
            np.zeros((count, redundant)),
            np.zeros((count, 6)),
        )

    def with_own_scratch(self) -> FaultModel:
        """Return the same hypotheses with memory of their own, for another estimator."""
        scratch = (self.entries, self.sensitivities, self.parity, self.components, self.shifts)
        return FaultModel(self.columns, self.coefficients, *(np.zeros_like(each) for each in scratch))


class JointCauses(NamedTuple):
    """The causes of faults of one joint, as ``posor_msgs/JointTransform`` states them."""

    names: tuple[str, ...] = ()
    of_effects: tuple[int, ...] = ()  # cause of each effect
    kinds: tuple[int, ...] = ()  # sum of the flags above of each effect
