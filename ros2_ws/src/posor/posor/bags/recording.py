# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Input of a calibration procedure: the scans of one POSOR and reference measurements of the same time span."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from posor.errors import ParameterError, ShapeError, TrackError
from posor.numerics.array_types import array_of_caller

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

SCALAR, POINT, POSE = 1, 3, 7  # columns of a track: one number; x, y, z [m]; x, y, z [m], quaternion x, y, z, w

_COLUMN_MEANING = {
    SCALAR: "one number (std_msgs/Float64)",
    POINT: "a point (geometry_msgs/PointStamped)",
    POSE: "a pose (geometry_msgs/TransformStamped or PoseStamped)",
}


@dataclass(frozen=True)
class Track:
    """Reference values over time, such as those of an interferometer or a CMM; array-likes become arrays.

    Raises:
        ParameterError: An array holds other than real numbers, or whole numbers for the stamps, or masked entries, or a
            standard uncertainty is negative or not finite.
        ShapeError: An array has the wrong shape.
        TrackError: The track is empty, its stamps do not increase, or a value is not finite.

    """

    stamps_ns: IntArray  # strictly increasing [ns], (n,)
    values: FloatArray  # (n, k), or (n,) for k = 1; see SCALAR, POINT, POSE; NaN where single quantities are missing
    sigmas: FloatArray  # standard uncertainty of each quantity, zero: not stated, (k,), or one number for k = 1
    source: str  # bag and topic, for error messages
    frame: str = ""  # in which points and poses are; empty: not stated

    def __post_init__(self) -> None:
        stamps = array_of_caller(self.stamps_ns, "stamps_ns", self.source, whole=True)
        values = array_of_caller(self.values, "values", self.source)
        sigmas = np.atleast_1d(array_of_caller(self.sigmas, "sigmas", self.source))
        if stamps.ndim != 1:
            raise ShapeError("stamps_ns", received=stamps.shape, expected="(n,)", where=self.source)
        if values.ndim not in (1, 2) or len(values) != len(stamps):
            expected = f"({len(stamps)}, k), or ({len(stamps)},) for one quantity"
            raise ShapeError("values", received=values.shape, expected=expected, where=self.source)
        values = values if values.ndim == 2 else values[:, None]  # noqa: PLR2004  one quantity
        if sigmas.shape != (values.shape[1],):
            expected = f"({values.shape[1]},), one for each quantity"
            raise ShapeError("sigmas", received=sigmas.shape, expected=expected, where=self.source)
        if not (np.isfinite(sigmas) & (sigmas >= 0.0)).all():
            expected = "finite standard uncertainties of zero or more"
            raise ParameterError(f"sigmas are {sigmas.tolist()}", where=self.source, expected=expected)
        for name, array in (("stamps_ns", stamps), ("values", values), ("sigmas", sigmas)):
            object.__setattr__(self, name, array)  # the dataclass is frozen
        if not len(self.stamps_ns):
            raise TrackError("holds no values", where=self.source)
        back = np.flatnonzero(np.diff(self.stamps_ns) <= 0)
        if back.size:
            before, after = (int(stamp) for stamp in self.stamps_ns[back[0] : back[0] + 2])
            raise TrackError(
                f"stamp {after} ns follows {before} ns", where=self.source, expected="strictly increasing stamps"
            )
        bad = np.flatnonzero(np.isinf(self.values).any(axis=1) | np.isnan(self.values).all(axis=1))
        if bad.size:
            raise TrackError(
                f"the value at {int(self.stamps_ns[bad[0]])} ns is not finite",
                where=self.source,
                expected="finite values",
            )

    def interpolate(self, stamps_ns: IntArray, longest_gap_ns: int) -> FloatArray:
        """Return the values at the given times [ns] (m,) by linear interpolation, (m, k).

        The result is NaN outside the track, between values further apart than ``longest_gap_ns``, and beside a
        missing value: nothing is extrapolated.
        """
        after = np.searchsorted(self.stamps_ns, stamps_ns)
        exact = np.isin(stamps_ns, self.stamps_ns)
        right = np.clip(after, 0, len(self.stamps_ns) - 1)
        left = np.where(exact, right, np.clip(after - 1, 0, len(self.stamps_ns) - 1))
        # Integers first: a stamp of today as a float has lost its nanoseconds.
        span = self.stamps_ns[right] - self.stamps_ns[left]
        share = np.where(span > 0, (stamps_ns - self.stamps_ns[left]) / np.maximum(span, 1), 0.0)
        values = self.values[left] + share[:, None] * (self.values[right] - self.values[left])
        outside = (after == 0) | (after == len(self.stamps_ns))
        values[~exact & (outside | (span > longest_gap_ns))] = np.nan
        return values


@dataclass(frozen=True)
class Recording:
    """Raw scans of one POSOR and the reference measurements recorded beside them."""

    scans: Scans  # stamps strictly increasing
    tracks: Mapping[str, Track]  # by topic; the quaternions of a pose keep their sign from sample to sample
    source: str  # path of the bag, for error messages and the fit record
    sha256: str = ""  # of the bag's files, 64 hexadecimal digits; empty when the data do not come from files
    statuses: IntArray | None = None  # status bits of ``posor_msgs/RawScan``, (n,); None: no bit is set
    frame: str = ""  # receiving frame of the scans; empty: unknown

    def has_status(self, flags: int) -> BoolArray:
        """Return which scans have any of these status bits set, (n,)."""
        if self.statuses is None:
            return np.zeros(len(self.scans), dtype=bool)
        return np.asarray((self.statuses & flags) != 0)

    def without_status(self, flags: int) -> Recording:
        """Return the recording without the scans that have any of these status bits set."""
        if self.statuses is None:
            return self
        valid = ~self.has_status(flags)
        return replace(self, scans=self.scans.select(valid), statuses=self.statuses[valid])

    def find_track(self, topic: str, columns: int) -> Track:
        """Return the reference on a topic (empty: the only one of its kind) with ``columns`` SCALAR, POINT or POSE.

        Raises TrackError: the reference is missing, ambiguous, or of another kind.
        """
        matching = [name for name, track in self.tracks.items() if track.values.shape[1] == columns]
        kind = _COLUMN_MEANING[columns]
        if not topic:
            if len(matching) != 1:
                what = f"{len(matching)} reference topics hold {kind}" if matching else f"no topic holds {kind}"
                raise TrackError(what, where=self.source, expected=f"one, of {_list_topics(matching or self.tracks)}")
            return self.tracks[matching[0]]
        if topic not in self.tracks:
            raise TrackError(
                f"there is no reference {topic}", where=self.source, expected=f"one of {_list_topics(self.tracks)}"
            )
        if topic not in matching:
            count = self.tracks[topic].values.shape[1]
            found = _COLUMN_MEANING.get(count, f"{count} numbers")
            raise TrackError(f"topic {topic} holds {found}", where=self.source, expected=kind)
        return self.tracks[topic]


def unpack_poses(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotations (n, 3, 3) and translations [m] (n, 3) of a pose track's values (n, 7).

    Averaged and interpolated quaternions are slightly short of unit length: only their direction counts.
    """
    return Rotation.from_quat(values[:, 3:]).as_matrix(), values[:, :3]


def _list_topics(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none, the recording has no reference"
