"""posor_node: turns the raw scans of one joint into six-degree-of-freedom transforms.

Subscribes ``raw`` (posor_msgs/RawScan), publishes ``transform`` (posor_msgs/JointTransform) for every scan. A scan that
gives no pose is reported too: state LOST, every number NaN, the reason in the diagnostics.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from posor_msgs.msg import JointTransform, RawScan
from pydantic import Field

from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.estimate import Estimate
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.posor import Posor
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.listeners import Listeners
from posor_estimator.ros.main import run
from posor_estimator.ros.messages import CovarianceKind, scan_from_message, stamp_ns, transform_message
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import RAW_TOPIC, TRANSFORM_TOPIC, sensor_qos

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration


class PosorParameters(NodeParameters):
    """Parameters of posor_node."""

    calibration: str = Field(description="path of the calibration file (YAML) of this joint's POSOR")
    session: str = Field(
        default="", description="session of the calibration file whose zero shifts and maps apply; empty: none"
    )
    covariance: CovarianceKind = Field(
        default="total",
        description="which uncertainty to publish: of the readings' noise, of the calibration, or of both",
    )
    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=1e-3, description="probability that the chi-square test of the redundant readings rejects a sound scan"
    )


class PosorEstimatorNode(PosorNode[PosorParameters]):
    """Estimates the pose of one POSOR's target plate from each raw scan."""

    NAME = "posor_node"
    Parameters = PosorParameters

    _calibration: Calibration
    _posor: Posor

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._status = self.diagnostics.add("estimate")
        self._listeners = Listeners(self)

    def configure(self) -> None:
        """Read the calibration file, say which one it is, and open the topics."""
        path = Path(self.parameters.calibration)
        whole = load_calibration(path)
        self._calibration = whole.for_session(self.parameters.session)
        self._posor = Posor(self._calibration, false_alarm=self.parameters.false_alarm)
        self._scans = self._lost = 0
        identity = {
            "calibration": whole.name,
            "calibration_file": str(path),
            "calibration_hash": whole.content_hash,
            "session": self.parameters.session,
        }
        self.get_logger().info(f"calibration '{whole.name}' from {path}, hash {whole.content_hash}")
        self._status.report(Level.STALE, "no scan yet", identity)
        qos = sensor_qos(self.parameters)
        self._publisher = self._listeners.publisher(JointTransform, TRANSFORM_TOPIC, qos)
        self._subscription = self.create_subscription(RawScan, RAW_TOPIC, self._locate, qos)

    def cleanup(self) -> None:
        """Close the topics and forget the calibration."""
        self.destroy_subscription(self._subscription)
        self.destroy_lifecycle_publisher(self._publisher)
        del self._posor, self._calibration

    def _locate(self, raw: RawScan) -> None:
        if not self._publisher.is_activated:
            return
        estimate = self._unfit(raw) or self._posor.locate(scan_from_message(raw))
        frames = self._calibration.frames
        message = transform_message(raw, estimate, frames.parent, frames.child, self.parameters.covariance)
        self._publisher.publish(message)
        self._report(estimate)

    def _unfit(self, raw: RawScan) -> Estimate | None:
        """Return a LOST estimate where the scan is not one of this POSOR's, or has no time."""
        parent = self._calibration.frames.parent
        where = f"scan {raw.scan}"
        if stamp_ns(raw) == 0:
            return Estimate.lost(
                raw.scan, Fault.BAD_READING, f"{where}: the stamp is zero; expected the time of exposure."
            )
        if raw.header.frame_id != parent:
            reason = f"{where}: comes from frame '{raw.header.frame_id}'; expected '{parent}', as in the calibration."
            return Estimate.lost(raw.scan, Fault.BAD_READING, reason)
        return None

    def _report(self, estimate: Estimate) -> None:
        self._scans += 1
        self._lost += estimate.state is State.LOST
        level = {State.OK: Level.OK, State.DEGRADED: Level.WARN}.get(estimate.state, Level.ERROR)
        faults = estimate.faults.name if estimate.faults else "none"
        values: dict[str, str | int | float] = {
            "scans": self._scans,
            "scans_lost": self._lost,
            "last_scan": estimate.scan,
            "faults": str(faults),
            "reason": estimate.reason,
            "residual": estimate.residual,
            "redundancy": estimate.redundancy,
        }
        self._status.report(level, f"{estimate.state.name.lower()}: {faults}", values)


def main() -> int:
    """Run the node as a program."""
    return run(PosorEstimatorNode)
