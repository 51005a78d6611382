"""posor_node: turns the raw scans of one joint into six-degree-of-freedom transforms.

Subscribes ``raw`` (posor_msgs/RawScan), publishes ``transform`` (posor_msgs/JointTransform) for every scan. A scan that
gives no pose is reported too: state LOST, every number NaN, the reason in the diagnostics.

Services (std_srvs/Trigger): ``~/reload`` reads the calibration file again, ``~/zero`` shifts the gap probes' zero so
that the present place is home, ``~/home`` counts theta from its home mark. What is refused leaves everything as it was.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any

from posor_msgs.msg import JointTransform, RawScan
from std_srvs.srv import Trigger

from posor_estimator.core.calibrate.digital_zero import digital_zero
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.posor import Posor
from posor_estimator.core.records import SAID_FAULTS, SAID_NEWS, SAID_STAMP, SAID_STATE, SAID_TAKEN
from posor_estimator.core.scan import Scans
from posor_estimator.errors import CalibrationError, ParameterError, PosorError, TopicError
from posor_estimator.posor_parameters import PosorParameters
from posor_estimator.ros.byte_lane import ByteLane
from posor_estimator.ros.cdr_scan import RAW_SCAN, scan_of
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.listeners import Listeners
from posor_estimator.ros.main import run
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.qos import RAW_TOPIC, TRANSFORM_TOPIC, sensor_qos
from posor_estimator.ros.wire import Inlet

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.ros.byte_lane import Answered
    from posor_estimator.ros.diagnostics import Value, Words


LOST = int(State.LOST)
HEALTH = {State.OK: Level.OK, State.DEGRADED: Level.WARN}
"""What the diagnostics make of a state; of any other, an error."""


class PosorEstimatorNode(PosorNode[PosorParameters]):
    """Estimates the pose of one POSOR's target plate from each raw scan.

    Scans may come in another thread than service calls: what both use is only used under a lock.
    """

    NAME = "posor_node"
    Parameters = PosorParameters

    _calibration: Calibration
    _posor: Posor
    _lane: ByteLane | None
    _recent: deque[bytes]
    _told: tuple[int, int] | None
    _last: ByteLane | None

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._lock = RLock()
        self._status = self.diagnostics.add("estimate", logged=True)
        self._listeners = Listeners(self)
        self._last = None
        self.diagnostics.before_each(self._refresh)

    def configure(self) -> None:
        """Read the calibration file, say which one it is, and open the topics."""
        self._scans = self._scans_lost = self._messages_refused = 0
        self._recent = deque(maxlen=self.parameters.zero_scans if self.parameters.home_pose else 0)
        self._taken = 0
        self._count_from_next = self._lost = False
        self._told = self._last = None
        self._take_calibration(*self._read())
        self._status.report(Level.STALE, "no scan yet")
        qos = sensor_qos(self.parameters)
        self._outlet = self._listeners.outlet(JointTransform, TRANSFORM_TOPIC, qos)
        self.when_cleaned_up(self._fall_silent)
        Inlet(self, RawScan, RAW_TOPIC, qos, self._take)
        for name, action in (("reload", self._reload), ("home", self._count_from_home), ("zero", self._zero)):
            if name != "zero" or self.parameters.home_pose:
                service = self.create_service(Trigger, f"~/{name}", partial(self._serve, action))
                self.when_cleaned_up(self.destroy_service, service)

    def _fall_silent(self) -> None:
        """Forget the scans, once one that is being answered has been."""
        with self._lock:
            self._lane = self._last = None

    def _read(self) -> tuple[Calibration, Calibration]:
        """Return what the calibration file says now, whole and with the session applied."""
        whole = load_calibration(Path(self.parameters.calibration))
        return whole, whole.for_session(self.parameters.session)

    def _take_calibration(self, whole: Calibration, applied: Calibration) -> None:
        """Put a calibration that was read into force, and say which one it is."""
        self._use(applied)
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

    def _use(self, calibration: Calibration) -> None:
        """Estimate by a calibration from the next scan on, which goes on from the last pose if there is one."""
        posor = Posor(calibration, false_alarm=self.parameters.false_alarm)
        with self._lock:
            if self._last is not None:
                posor.go_on_from(self._posor)
            self._posor, self._calibration, self._lane = posor, calibration, None
            self._taken = 0  # of another POSOR the count begins anew; the scans that were kept go with its first one

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
        self._take_calibration(whole, applied)
        return f"calibration '{whole.name}', hash {whole.content_hash}"

    def _count_from_home(self) -> str:
        if not self._posor.counting:
            raise ParameterError(
                "theta is not counted",
                where=f"calibration '{self._calibration.name}'",
                expected="a bumpy ring; ~/set_home of the chain makes poses relative to home",
            )
        with self._lock:
            self._count_from_next = True
            if self._lane is not None:
                self._lane.count_from_next()
        return "theta is counted from the next scan, which is taken to be within half a bump of the home mark"

    def _zero(self) -> str:
        with self._lock:
            recent = list(self._recent)
        if len(recent) < self.parameters.zero_scans:
            raise ParameterError(
                f"{len(recent)} sound scans so far", where="zero", expected=f"{self.parameters.zero_scans}"
            )
        gap, alpha, beta = self.parameters.home_pose
        zero = digital_zero(self._calibration, Scans.of([scan_of(data) for data in recent]), (gap, alpha, beta))
        self._use(zero.calibration)
        said = f"zero_shifts: {{value: {_listed(zero.shifts.array)}, sigma: {_listed(zero.shifts.sigmas)}, unit: V}}"
        self._status.update({"zero": said})
        text = f"{said}, changed by {_listed(zero.changes)} V; in force until the calibration is read again"
        self.get_logger().info(text)
        return text

    def _take(self, data: bytes) -> None:
        """Answer a raw scan."""
        with self._lock:
            if not self.may_publish:
                return
            lane = self._lane
            answer = None if lane is None else lane.answer(data)
            if answer is None:
                answer = self._answer_another_kind(data)
                lane = self._lane
            if answer is not None and lane is not None:
                self._outlet.publish(answer)
                self._note(lane, data)

    def _answer_another_kind(self, data: bytes) -> bytes | None:
        """Answer a raw scan that is not like those before: make another lane for it, or say what is wrong with it."""
        try:
            data = RAW_SCAN.normal(data)
            lane = ByteLane(self._posor, data, self.parameters.covariance)
        except TopicError as error:
            self._messages_refused += 1
            self._told = None
            self._status.report(Level.ERROR, f"no estimate: {error}", {"messages_refused": self._messages_refused})
            return None
        if self._lane is not None:
            self._recent.clear()
        self._lane = lane
        if self._count_from_next:
            lane.count_from_next()
        return lane.answer(data)

    def _note(self, lane: ByteLane, data: bytes) -> None:
        """Count a scan that has been answered, keep a sound one for a digital zero, say how it went if it is news."""
        said = lane.said
        if stamp_ns := said[SAID_STAMP]:
            self.timing.note(stamp_ns)
        self._scans += 1
        if said[SAID_NEWS] or self._told is None:
            self._note_news(lane)
        if self._lost:
            self._scans_lost += 1
        else:
            self._recent.append(data)
        if self._count_from_next:
            self._count_from_next = lane.counts_from_next

    def _note_news(self, lane: ByteLane) -> None:
        """Note of a scan what is not as with the one before.

        One without a pose, or of another kind, breaks the row of those that are kept.
        """
        state, faults, taken = (lane.said[column] for column in (SAID_STATE, SAID_FAULTS, SAID_TAKEN))
        self._last, self._lost = lane, state == LOST
        if self._lost or taken != self._taken:
            self._recent.clear()
            self._taken = taken
        if (state, faults) != self._told:
            self._told = (state, faults)
            level = HEALTH.get(State(state), Level.ERROR)
            counts = {**self._counts(), "scans_lost": self._scans_lost + self._lost}
            self._status.report_news(level, partial(_verdict_in_words, state, faults, counts, lane.answered()))

    def _counts(self) -> dict[str, Value]:
        return {"scans": self._scans, "scans_lost": self._scans_lost}

    def _refresh(self) -> None:
        """Bring the values up to date, once a second."""
        with self._lock:
            if self._last is None:
                return
            counts, last = self._counts(), self._last.answered()
        self._status.update(_values_of(counts, last))


def _verdict_in_words(state: int, faults: int, counts: dict[str, Value], scan: Answered) -> Words:
    said = Fault(faults).name if faults else "none"
    return f"{State(state).name.lower()}: {said}", {"faults": str(said), **_values_of(counts, scan)}


def _values_of(counts: dict[str, Value], scan: Answered) -> dict[str, Value]:
    """Return what is to be said of a scan, beside its state and faults."""
    return {
        **counts,
        "last_scan": scan.number,
        "reason": scan.reason,
        "residual": scan.verdict.residual,
        "redundancy": scan.verdict.redundancy,
    }


def _listed(numbers: Iterable[float]) -> str:
    return f"[{', '.join(f'{number:.6g}' for number in numbers)}]"


def main() -> int:
    """Run the node as a program."""
    return run(PosorEstimatorNode)
