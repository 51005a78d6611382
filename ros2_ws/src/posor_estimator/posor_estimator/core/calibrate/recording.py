"""What a calibration procedure works on: scans and reference measurements of the same time span."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor_estimator.errors import TrackError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.calibrate.track import Track
    from posor_estimator.core.scan import Scans

SCALAR, POINT, POSE = 1, 3, 7
"""Columns of a track: one number; x, y, z [m]; x, y, z [m] and the unit quaternion x, y, z, w."""

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
        left_out: Scans that the bag holds but that are not here, because a reading was filled in or saturated.

    """

    scans: Scans
    tracks: Mapping[str, Track]
    source: str
    sha256: str = ""
    left_out: int = 0

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
                raise TrackError(what, where=self.source, expected=f"one named, of {_listed(fit or self.tracks)}")
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


def _listed(names: Mapping[str, Track] | list[str]) -> str:
    return ", ".join(sorted(names)) or "none, the recording has no reference"
