"""What a calibration procedure works on: scans and reference measurements of the same time span."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from posor_estimator.errors import TrackError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.calibrate.track import Track
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

SCALAR, POINT, POSE = 1, 3, 7
"""Columns of a track: one number; x, y, z [m]; x, y, z [m] and the unit quaternion x, y, z, w."""

PROBES_ESTIMATED, DIODES_ESTIMATED, SATURATED = 1, 2, 16
"""Status bits of ``posor_msgs/RawScan``: a probe or diode reading was filled in; a channel was at its range's end."""

_KINDS = {
    SCALAR: "one number (std_msgs/Float64)",
    POINT: "a point (geometry_msgs/PointStamped)",
    POSE: "a pose (geometry_msgs/TransformStamped)",
}


@dataclass(frozen=True)
class Recording:
    """Raw readings of one POSOR and the reference measurements that were taken beside them.

    Attributes:
        scans: The raw readings, stamps strictly increasing.
        tracks: Reference measurements by topic. A pose's quaternion keeps its sign from sample to sample.
        source: What to call it in complaints and in the result: path of the bag.
        sha256: Of the bag's files, 64 hexadecimal digits; empty when it does not come from files.
        statuses: Status bits of each scan, (n,), as ``posor_msgs/RawScan`` has them; None: none is set.
        frame: Of the receiving plate that the scans are of; empty: not said.

    """

    scans: Scans
    tracks: Mapping[str, Track]
    source: str
    sha256: str = ""
    statuses: IntArray | None = None
    frame: str = ""

    def having(self, flags: int) -> BoolArray:
        """Return which scans have any of these status bits set, (n,) of truth values."""
        if self.statuses is None:
            return np.zeros(len(self.scans), dtype=bool)
        return np.asarray((self.statuses & flags) != 0)

    def without(self, flags: int) -> Recording:
        """Return the recording without the scans that have any of these status bits set, such as ``SATURATED``."""
        if self.statuses is None:
            return self
        kept = ~self.having(flags)
        return replace(self, scans=self.scans.chosen(kept), statuses=self.statuses[kept])

    def track(self, topic: str, columns: int) -> Track:
        """Return a reference measurement.

        Args:
            topic: Its topic; empty: the only one of its kind.
            columns: ``SCALAR``, ``POINT`` or ``POSE``.

        Raises:
            TrackError: There is none, there are several to choose from, or it is of another kind.

        """
        fit = [name for name, track in self.tracks.items() if track.values.shape[1] == columns]
        if not topic:
            if len(fit) != 1:
                what = (
                    f"{len(fit)} reference topics hold {_KINDS[columns]}"
                    if fit
                    else f"no topic holds {_KINDS[columns]}"
                )
                raise TrackError(what, where=self.source, expected=f"one, of {_listed(fit or self.tracks)}")
            return self.tracks[fit[0]]
        if topic not in self.tracks:
            raise TrackError(
                f"there is no reference {topic}", where=self.source, expected=f"one of {_listed(self.tracks)}"
            )
        if topic not in fit:
            has = self.tracks[topic].values.shape[1]
            raise TrackError(
                f"topic {topic} holds {_KINDS.get(has, f'{has} numbers')}", where=self.source, expected=_KINDS[columns]
            )
        return self.tracks[topic]


def poses_of(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotations (n, 3, 3) and translations [m] (n, 3) of a pose track's values (n, 7).

    Means and interpolations of quaternions are a little short of unit length: they are taken by their direction.
    """
    return Rotation.from_quat(values[:, 3:]).as_matrix(), values[:, :3]


def _listed(names: Mapping[str, Track] | list[str]) -> str:
    return ", ".join(sorted(names)) or "none, the recording has no reference"
