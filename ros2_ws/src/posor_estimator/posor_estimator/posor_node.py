"""posor_node: turns the raw scans of one joint into six-degree-of-freedom transforms.

Subscribes ``raw`` (posor_msgs/RawScan), publishes ``transform`` (posor_msgs/JointTransform) for every scan. A scan that
gives no pose is reported too: state LOST, every number NaN, the reason in the diagnostics.

Services (std_srvs/Trigger): ``~/reload`` reads the calibration file again, ``~/zero`` shifts the gap probes' zero so
that the present place is home, ``~/home`` counts theta from its home mark. What is refused leaves everything as it was.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from posor_msgs.msg import JointTransform, RawScan
from pydantic import Field, field_validator
from std_srvs.srv import Trigger

from posor_estimator.core.calibrate.digital_zero import LEAST, digital_zero
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.estimate import Estimate
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.posor import Posor
from posor_estimator.core.scan import Scan, Scans
from posor_estimator.errors import CalibrationError, ParameterError, PosorError
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.listeners import Listeners
from posor_estimator.ros.main import run
from posor_estimator.ros.messages import CovarianceKind, scan_from_message, stamp_ns, transform_message
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import RAW_TOPIC, TRANSFORM_TOPIC, sensor_qos

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

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
    home_pose: tuple[float, ...] = Field(
        default=(),
        description="gap [m], alpha and beta [rad] of the place that ~/zero makes home; empty: no such service",
    )
    zero_scans: Annotated[int, Field(ge=LEAST, le=100_000)] = Field(
        default=100, description="number of scans, the last ones, whose mean ~/zero takes"
    )

    @field_validator("home_pose")
    @classmethod
    def _three(cls, home: tuple[float, ...]) -> tuple[float, ...]:
        if len(home) not in (0, len(HOME)):
            message = f"{len(home)} numbers; expected 3: {', '.join(HOME)}, or none"
            raise ValueError(message)
        return home


HOME = ("gap", "alpha", "beta")


class PosorEstimatorNode(PosorNode[PosorParameters]):
    """Estimates the pose of one POSOR's target plate from each raw scan."""

    NAME = "posor_node"
    Parameters = PosorParameters

    _calibration: Calibration
    _posor: Posor
    _recent: deque[Scan]
    _count_from_next: bool

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._status = self.diagnostics.add("estimate")
        self._listeners = Listeners(self)

    def configure(self) -> None:
        """Read the calibration file, say which one it is, and open the topics."""
        self._scans = self._lost = 0
        self._recent = deque(maxlen=self.parameters.zero_scans)
        self._count_from_next = False
        self._take_calibration(*self._read())
        self._status.report(Level.STALE, "no scan yet")
        qos = sensor_qos(self.parameters)
        self._publisher = self._listeners.publisher(JointTransform, TRANSFORM_TOPIC, qos)
        self._subscription = self.create_subscription(RawScan, RAW_TOPIC, self._locate, qos)
        self._services = [
            self.create_service(Trigger, f"~/{name}", partial(self._serve, action))
            for name, action in (("reload", self._reload), ("home", self._count_from_home), ("zero", self._zero))
            if name != "zero" or self.parameters.home_pose
        ]

    def cleanup(self) -> None:
        """Close topics and services and forget the calibration."""
        for service in self._services:
            self.destroy_service(service)
        self.destroy_subscription(self._subscription)
        self.destroy_lifecycle_publisher(self._publisher)
        del self._posor, self._calibration

    def _read(self) -> tuple[Calibration, Calibration]:
        """Return what the calibration file says now, whole and with the session applied."""
        whole = load_calibration(Path(self.parameters.calibration))
        return whole, whole.for_session(self.parameters.session)

    def _take_calibration(self, whole: Calibration, applied: Calibration) -> None:
        """Put a calibration that was read into force, and say which one it is."""
        self._posor = Posor(applied, false_alarm=self.parameters.false_alarm)
        self._calibration = applied
        path = self.parameters.calibration
        self._status.update(
            {
                "calibration": whole.name,
                "calibration_file": path,
                "calibration_hash": whole.content_hash,
                "session": self.parameters.session,
                "zero": "as in the file",
            }
        )
        self.get_logger().info(f"calibration '{whole.name}' from {path}, hash {whole.content_hash}")

    def _serve(
        self, action: Callable[[], str], _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Do what a service is for; what is refused leaves everything as it was."""
        try:
            response.message = action()
        except PosorError as error:
            response.message = str(error)
            self.get_logger().error(response.message)
        else:
            response.success = True
        return response

    def _reload(self) -> str:
        whole, applied = self._read()
        frames = self._calibration.frames
        if applied.frames != frames:
            raise CalibrationError(
                f"its frames are {applied.frames.parent} and {applied.frames.child}",
                where=f"calibration file {self.parameters.calibration}",
                expected=f"{frames.parent} and {frames.child} as before, or a restart of the node",
            )
        former = self._posor
        self._take_calibration(whole, applied)
        self._posor.go_on_from(former)
        return f"calibration '{whole.name}', hash {whole.content_hash}"

    def _count_from_home(self) -> str:
        if not self._posor.counting:
            raise ParameterError(
                "theta is not counted",
                where=f"calibration '{self._calibration.name}'",
                expected="a bumpy ring; ~/set_home of the chain makes poses relative to home",
            )
        self._count_from_next = True
        return "theta is counted from the next scan, which is taken to be within half a bump of the home mark"

    def _zero(self) -> str:
        if len(self._recent) < self.parameters.zero_scans:
            raise ParameterError(
                f"{len(self._recent)} sound scans so far", where="zero", expected=f"{self.parameters.zero_scans}"
            )
        gap, alpha, beta = self.parameters.home_pose
        zero = digital_zero(self._calibration, Scans.of(list(self._recent)), (gap, alpha, beta))
        former = self._posor
        self._posor = Posor(zero.calibration, false_alarm=self.parameters.false_alarm)
        self._posor.go_on_from(former)
        self._calibration = zero.calibration
        said = f"zero_shifts: {{value: {_listed(zero.shifts.array)}, sigma: {_listed(zero.shifts.sigmas)}, unit: V}}"
        self._status.update({"zero": said})
        text = f"{said}, changed by {_listed(zero.changes)} V; in force until the calibration is read again"
        self.get_logger().info(text)
        return text

    def _locate(self, raw: RawScan) -> None:
        if not self._publisher.is_activated:
            return
        estimate = self._unfit(raw)
        if estimate is None:
            scan = replace(scan_from_message(raw), at_home=True) if self._count_from_next else scan_from_message(raw)
            self._count_from_next = False
            estimate = self._posor.locate(scan)
            self._remember(scan, estimate)
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

    def _remember(self, scan: Scan, estimate: Estimate) -> None:
        """Keep a sound scan for a digital zero; one without a pose, or of another kind, breaks the row."""
        if estimate.state is State.LOST or (self._recent and scan.lit_sources != self._recent[-1].lit_sources):
            self._recent.clear()
        if estimate.state is not State.LOST:
            self._recent.append(scan)

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


def _listed(numbers: Iterable[float]) -> str:
    return f"[{', '.join(f'{number:.6g}' for number in numbers)}]"


def main() -> int:
    """Run the node as a program."""
    return run(PosorEstimatorNode)
