# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimate of a scan: pose, covariance, chi-square, state."""

from __future__ import annotations

from collections import Counter, namedtuple
from copy import copy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from posor.estimation.fault_model import EFFECT
from posor.model.fault import Fault, State
from posor.model.native_coordinates import native_from_rotation
from posor.model.scan import MAX_TERMS, Scans
from posor.numerics.stamps import NS, span_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import pinocchio as pin
    from numpy.typing import NDArray

    from posor.model.scan import Scan
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

ESTIMATE = np.dtype(  # the estimate of one scan as the kernels write it; fields as in ``Estimate`` and ``Estimates``
    [
        ("number", "u8"),  # of the scan
        ("stamp_ns", "i8"),
        ("state", "i8"),  # State
        ("faults", "i8"),  # Fault
        ("sensor", "i8"),  # whose readings are invalid; -1: none
        ("code", "i8"),  # of that sensor, see model.readings
        ("residual", "f8"),
        ("redundancy", "i8"),
        ("rotation", "f8", (3, 3)),
        ("translation", "f8", (3,)),
        ("pose", "f8", (7,)),
        ("native", "f8", (6,)),
        ("random", "f8", (6, 6)),
        ("systematic", "f8", (6, 6)),
        ("shared", "f8", (MAX_TERMS, 6)),  # effects of shared terms; only those of the calibration's terms are written
        ("stamp_shift", "f8", (6,)),
    ],
    align=True,
)


_make_type: Any = namedtuple  # noqa: PYI024  the names are those of the record, which mypy does not know
_Fields = _make_type("_Fields", ESTIMATE.names)
NO_STAMP, OTHER_FRAME = -101, -102
"""``code`` of a recorded scan that is not estimated: its stamp is invalid, or it comes from another frame."""
_STATES = tuple(State)
_ATTRIBUTES = {  # attributes of ``Estimates`` that are fields of the records
    "numbers": "number",
    "stamps_ns": "stamp_ns",
    "states": "state",
    "faults": "faults",
    "redundancies": "redundancy",
    "rotations": "rotation",
    "translations": "translation",
    "poses": "pose",
    "natives": "native",
    "covariances_random": "random",
    "covariances_systematic": "systematic",
    "shared_effects": "shared",
    "stamp_shifts": "stamp_shift",
}


class Estimate(NamedTuple):
    """The pose ``T_R_T`` that one scan gives.

    Attributes:
        number: Number of the scan.
        state: Whether the pose can be used.
        faults: Why the state is not OK.
        reason: One sentence on the fault, empty when there is none.
        T_R_T: The pose; None when the state is LOST.
        theta: The large rotation, turns counted [rad]; NaN when the state is LOST.
        covariance_random: From the noise of the readings, white from scan to scan, (6, 6): x, y, z [m], about X, Y, Z
            [rad], axes of R, the small turn applied on the parent's side at the origin of T (ROS order, REP-103).
            JCGM 100, 5.1.
        covariance_systematic: From the uncertainties of the calibration parameters, the same order; common to all
            scans of one calibration. JCGM 100, 5.2.
        residual: Chi-square of the redundant readings, weighted by their random and systematic variances.
        redundancy: Degrees of freedom of the residual.
        stamp_shift: Largest error of the pose by an error of the stamp within ``Scan.stamp_limit``, along and about
            each axis, (6,), the same order; infinite: not bounded; zero: no limit is stated.

    """

    number: int
    state: State
    faults: Fault
    reason: str
    T_R_T: pin.SE3 | None
    theta: float
    covariance_random: FloatArray
    covariance_systematic: FloatArray
    residual: float
    redundancy: int
    stamp_shift: FloatArray

    @staticmethod
    def lost(number: int, faults: Fault, reason: str) -> Estimate:
        """Return the estimate of a scan that gives no pose."""
        unknown, nan = np.full((6, 6), np.nan), float("nan")
        return Estimate(number, State.LOST, faults, reason, None, nan, unknown, unknown, nan, 0, unknown[0])

    @property
    def native(self) -> FloatArray:
        """(x, y, gap [m], alpha, beta, theta [rad]), see ``model.native_coordinates``; NaN when the state is LOST."""
        if self.T_R_T is None:
            return np.full(6, np.nan)
        alpha, beta, _ = native_from_rotation(self.T_R_T.rotation)
        return np.array([*self.T_R_T.translation, alpha, beta, self.theta])

    def covariance(self) -> FloatArray:
        """Return the sum of the random and the systematic covariance, (6, 6)."""
        return self.covariance_random + self.covariance_systematic

    def __repr__(self) -> str:
        place = "" if self.T_R_T is None else ", x, y, z [m]: " + ", ".join(f"{x:.7g}" for x in self.T_R_T.translation)
        return f"<Estimate of scan {self.number}: {self.state.name}{place}{self.reason and f', {self.reason}'}>"


def estimate_of(records: NDArray[np.void], index: int, reason: str) -> Estimate:
    """Return a copy of an estimate record (n,), dtype ESTIMATE, given the sentence on its fault."""
    import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

    fields = _Fields._make(records.item(index))
    state, faults = _STATES[fields.state], Fault(fields.faults) if fields.faults else Fault.NONE
    if state is State.LOST:
        return Estimate.lost(fields.number, faults, reason)
    return Estimate(
        fields.number,
        state,
        faults,
        reason,
        pin.SE3(fields.rotation, fields.translation),
        float(fields.native[5]),
        fields.random.copy(),
        fields.systematic.copy(),
        fields.residual,
        fields.redundancy,
        fields.stamp_shift.copy(),
    )


class Estimates:
    """The poses of n scans of one POSOR, receiving plate to target plate, from a bag or from ``Scans``.

    Every number of the pose of a LOST scan is NaN. The arrays are read-only.

    Attributes:
        numbers: Number of each scan, shape (n,).
        stamps_ns: Middle of each exposure [ns], shape (n,); 0: invalid.
        log_times_ns: When each scan was logged in its bag [ns], shape (n,); 0: not from a bag.
        statuses: Flags of the driver, ``posor_msgs/RawScan.status``, shape (n,).
        header_stamps: Seconds and nanoseconds of each stamp as recorded, shape (n, 2).
        states: ``State`` of each scan, shape (n,).
        faults: ``Fault`` flags of each scan, shape (n,).
        rotations: R_R_T, shape (n, 3, 3).
        translations: Origin of T in R [m], shape (n, 3).
        poses: ``T_R_T`` as x, y, z [m] and the unit quaternion x, y, z, w, shape (n, 7).
        natives: x, y, gap [m], alpha, beta, theta [rad], see ``model.native_coordinates``, shape (n, 6).
        residuals: Chi-square of the redundant readings, shape (n,).
        redundancies: Degrees of freedom of each chi-square; 0 of a LOST scan, shape (n,).
        covariances_random: From the noise of the readings, see ``Estimate``, shape (n, 6, 6).
        covariances_systematic: From the uncertainties of the calibration, shape (n, 6, 6).
        shared_effects: Change of the pose by one standard uncertainty of each shared term of the calibration file, in
            its order, as ``covariances_systematic``, which contains them, shape (n, 8, 6); zero behind the last term.
        stamp_shifts: Largest errors by errors of the stamps, see ``Estimate.stamp_shift``, shape (n, 6).
        fault_effects: What each of ``Posor.hypotheses`` may do to each pose unseen, shape (n, C, 7), floats of 4 bytes:
            change of the pose in ROS order and its cut (``estimation.fault_effects``); (n, 0, 7): not asked for.

    """

    numbers: NDArray[np.uint64]
    stamps_ns: IntArray
    states: IntArray
    faults: IntArray
    redundancies: IntArray
    rotations: FloatArray
    translations: FloatArray
    poses: FloatArray
    natives: FloatArray
    covariances_random: FloatArray
    covariances_systematic: FloatArray
    shared_effects: FloatArray
    stamp_shifts: FloatArray

    def __init__(
        self,
        records: NDArray[np.void],
        scans: Scans,
        explain: Callable[[Scan, Any], str],
        *,
        log_times_ns: IntArray | None = None,
        header_stamps: IntArray | None = None,
        fault_effects: NDArray[np.float32] | None = None,
    ) -> None:
        none = np.zeros((len(records), 0, EFFECT), dtype=np.float32)
        self.fault_effects: NDArray[np.float32] = (none if fault_effects is None else fault_effects).view()
        self._records = records.view()
        self._scans, self._explain = scans, explain
        self.log_times_ns = (np.zeros(len(records), dtype=np.int64) if log_times_ns is None else log_times_ns).view()
        if header_stamps is None:
            header_stamps = np.column_stack(np.divmod(records["stamp_ns"], NS))
        self.header_stamps = header_stamps.view()
        for array in (self._records, self.log_times_ns, self.header_stamps, self.fault_effects):
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self._records)

    def __repr__(self) -> str:
        counts = sorted(Counter(self.states.tolist()).items())
        states = ", ".join(f"{count} {State(state).name}" for state, count in counts)
        if len(self) and [state for state, _ in counts] == [int(State.LOST)]:
            states += f" ({next(iter(self.lost_reasons()))})"
        return f"<{len(self)} Estimates: {states or 'none'}{span_text(self.stamps_ns)}>"

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name not in _ATTRIBUTES:
            raise AttributeError(f"'Estimates' has no attribute '{name}'", name=name, obj=self)
        return self._records[_ATTRIBUTES[name]]

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *_ATTRIBUTES})

    @property
    def scans(self) -> Scans:
        """The raw scans, n."""
        return self._scans

    @property
    def statuses(self) -> IntArray:
        """See the class."""
        return self._scans.statuses

    @property
    def thetas(self) -> FloatArray:
        """The large rotation, turns counted [rad], shape (n,)."""
        return self.natives[:, 5]

    @property
    def residuals(self) -> FloatArray:
        """See the class."""
        return np.where(self.states == int(State.LOST), np.nan, self._records["residual"])

    def covariances(self) -> FloatArray:
        """Return the sums of the random and the systematic covariances, shape (n, 6, 6).

        They are of x, y, z [m] and small turns about X, Y, Z [rad], axes of the receiving plate (ROS order, REP-103).
        """
        return self.covariances_random + self.covariances_systematic

    @property
    def standard_uncertainties(self) -> FloatArray:
        """Square roots of the variances of ``covariances()``: x, y, z [m], about X, Y, Z [rad], shape (n, 6)."""
        return np.sqrt(np.diagonal(self.covariances(), axis1=1, axis2=2))

    def reason(self, index: int) -> str:
        """Return the sentence on the faults of a scan, as ``Estimate.reason``; empty without a fault."""
        return self._explain(self._scans[index], self._records[index])

    def lost_reasons(self) -> dict[str, int]:
        """Return the number of LOST scans by reason, the most frequent first.

        Scans with the same faults of the same reading have one reason: the sentence of the first of them.
        """
        lost = np.flatnonzero(self.states == int(State.LOST))
        kinds = np.column_stack([self._records[name][lost] for name in ("faults", "sensor", "code")])
        _, first, counts = np.unique(kinds, axis=0, return_index=True, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        return {self.reason(int(lost[first[n]])): int(counts[n]) for n in order}

    def select(self, which: BoolArray | IntArray | slice) -> Estimates:
        """Return the estimates of some of the scans, by truth values (n,), indices or a slice."""
        return Estimates(
            self._records[which],
            self._scans.select(which),
            self._explain,
            log_times_ns=self.log_times_ns[which],
            header_stamps=self.header_stamps[which],
            fault_effects=self.fault_effects[which],
        )

    @staticmethod
    def concatenate(parts: Sequence[Estimates]) -> Estimates:
        """Return the estimates of several parts of one POSOR, one after the other; at least one part."""
        if len(parts) == 1:
            return parts[0]
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("_records", "log_times_ns", "header_stamps", "fault_effects")
        }
        for array in columns.values():
            array.flags.writeable = False
        joined = copy(parts[0])
        vars(joined).update(columns, _scans=Scans.concatenate([vars(part)["_scans"] for part in parts]))
        return joined
