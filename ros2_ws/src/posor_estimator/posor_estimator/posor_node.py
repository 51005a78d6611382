# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor_node: estimates six-degree-of-freedom transforms from the raw scans of one joint.

Subscribes to ``raw`` (posor_msgs/RawScan) and publishes ``transform`` (posor_msgs/JointTransform) for every scan. A
scan without a pose is published with the state LOST and NaN in every number; the diagnostics give the reason.

Services (std_srvs/Trigger): ``~/reload`` reads the calibration file again; ``~/zero`` shifts the zero of the gap probes
so that the present pose is home; ``~/home`` counts theta from its home mark. ``~/acknowledge`` (posor_msgs/Acknowledge)
ends a latched fault. A refused request changes nothing. With ``allow_changes: false`` these services do not exist.

With an encoder, ``encoder`` (sensor_msgs/JointState) confirms theta.
"""

from __future__ import annotations

import math
import time
from collections import deque
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.calibration.calibration_file import load_calibration
from posor.errors import CalibrationError, ParameterError, PosorError, TopicError
from posor.estimation.digital_zero import find_digital_zero
from posor.estimation.posor import Posor
from posor.messages.message_stream import RawScanStream
from posor.messages.raw_scan import scan_of
from posor.model.fault import Fault, State
from posor.model.scan import Scans
from posor.node_parameters import PosorParameters
from posor.numerics.vector import wrapped
from posor.ros_names import RAW_TOPIC, TRANSFORM_THROTTLE_TOPIC, TRANSFORM_TOPIC
from posor_msgs.msg import JointTransform, RawScan
from posor_msgs.srv import Acknowledge
from posor_ros.delivery_round import DeliveryGroup
from posor_ros.diagnostics import Level
from posor_ros.freshness import REPEATED, InputMonitor, ScanOrder
from posor_ros.intra_process import IntraProcessManager, IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.message_classes import schema_of_class
from posor_ros.node_program import run_node
from posor_ros.qos import input_qos, result_qos
from posor_ros.throttled_publisher import ThrottledPublisher

from posor_estimator.alarm_rate import AlarmRate
from posor_estimator.encoder_subscription import subscribe_to_encoder
from posor_estimator.endpoint_verdict import NOT_COUNTED, waits_to_be_counted
from posor_estimator.fault_release import EncoderReading, FaultRelease, check_plausible
from posor_estimator.prepared_scan import PreparedScan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from posor.calibration.calibration_file import Calibration
    from posor.messages.message_stream import EstimatedScan
    from posor_ros.delivery_round import Delivery, GroupMember
    from posor_ros.diagnostics import StatusText, Value
    from std_srvs.srv import Trigger


LOST = int(State.LOST)
LEVELS = {State.OK: Level.OK, State.DEGRADED: Level.WARN, State.LOST: Level.WARN}
"""Level of the diagnostics by state; other states, and what ``AlarmRate`` finds: ERROR, UNCOUNTED that waits: WARN."""
STEPPED = (
    "the stamps, or the clock of this host, have stepped by {:.3g} s, and the stamps count as wrong by as much; "
    "expected right stamps, then ~/acknowledge"
)


class PosorEstimatorNode(PosorNode[PosorParameters]):
    """Estimates the pose of one POSOR's target plate from each raw scan.

    Scans and service calls may come in different threads; a lock protects their common state. The scans of all joints
    of an arm in one process are estimated in one compiled call per tick, see ``estimate_scans``.
    """

    NAME = "posor_node"
    Parameters = PosorParameters

    _calibration: Calibration
    _posor: Posor
    _stream: RawScanStream | None
    _last_stream: RawScanStream | None
    _recent_scans: deque[bytes]
    _reported: tuple[int, int, bool] | None
    _alarms: AlarmRate
    _order: ScanOrder
    _release: FaultRelease
    _encoder: EncoderReading | None

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._lock = IntraProcessManager.of(self.context).delivery_lock(self.get_namespace().rpartition("/")[0])
        self._status = self.diagnostics.add_status("estimate", logged=True)
        self._stamps = self.diagnostics.add_status("stamps")
        self._last_stream = None
        self._inputs = InputMonitor(self, self._on_inputs_checked)
        self.diagnostics.add_refresh(self._refresh_status)

    def configure(self) -> None:
        """Read the calibration file, report its identity and open the topics and services."""
        self._scans = self._scans_lost = self._messages_refused = 0
        self._recent_scans = deque(maxlen=self.parameters.zero_scans if self.parameters.home_pose else 0)
        self._source_changes = 0
        self._count_from_next = self._is_lost = False
        self._reported = self._last_stream = self._encoder = None
        self._release = FaultRelease(self.parameters.acknowledge_interval)
        self._alarms = AlarmRate(self.parameters.false_alarm, self.parameters.alarm_count)
        self._order = ScanOrder()
        self._apply_calibration(*self._load_calibration())
        self._status.report(Level.STALE, "no scan yet")
        qos = result_qos(self.parameters)
        self._publisher = IntraProcessPublisher(self, JointTransform, TRANSFORM_TOPIC, qos, count_listeners=True)
        self._throttle = ThrottledPublisher(self, JointTransform, TRANSFORM_THROTTLE_TOPIC, qos)
        self.add_cleanup(self._forget_scans)
        self.add_cleanup(self._inputs.clear)
        qos = input_qos(self.parameters)
        group = DeliveryGroup(self.estimate_scans, self._lock)
        self._inputs.add(IntraProcessSubscription(self, RawScan, RAW_TOPIC, qos, group))
        if self.parameters.encoder.sigma:
            subscribe_to_encoder(self, self._inputs, self._confirm_theta)
        services = {"reload": self._reload_calibration, "home": self._count_from_home}
        if self.parameters.home_pose:
            services["zero"] = self._zero_gap_probes
        for name, action in services.items():
            self.add_change_service(name, partial(self._respond, action))
        self.add_change_service("acknowledge", partial(self._respond, self._acknowledge_fault), Acknowledge)

    def activate(self) -> None:
        """Expect scans with present stamps from now on."""
        self._inputs.start()

    def deactivate(self) -> None:
        """Discard kept scans and a pending ``~/home``: the target may move before the next scan."""
        self._inputs.stop()
        with self._lock:
            self._stream = self._encoder = None
            self._count_from_next = self._is_lost = False
            self._recent_scans.clear()

    def _on_inputs_checked(self, is_new: bool) -> None:  # noqa: FBT001  a callback
        """Report that no scan arrives, and discard the kept ones; the next scan is reported again."""
        if is_new and self._inputs.silent:
            with self._lock:
                self._reported = None
                self._recent_scans.clear()
                self._status.report(Level.ERROR, f"no estimate: {self._inputs.silent}", self._counts())

    def _forget_scans(self) -> None:
        """Discard the estimator's streams after the present scan."""
        with self._lock:
            self._stream = self._last_stream = None

    def _load_calibration(self) -> tuple[Calibration, Calibration]:
        """Return the calibration of the file, and the same with the session applied."""
        calibration = load_calibration(Path(self.parameters.calibration))
        return calibration, calibration.for_session(self.parameters.session)

    def _apply_calibration(self, calibration: Calibration, session_calibration: Calibration) -> None:
        self._use_calibration(session_calibration)
        path = self.parameters.calibration
        self._status.update(
            {
                "calibration": calibration.name,
                "calibration_file": path,
                "calibration_hash": calibration.content_hash,
                "session": self.parameters.session,
                "zero": "as in the file",
            }
        )
        self.get_logger().info(f"calibration '{calibration.name}' from {path}, hash {calibration.content_hash}")

    def _use_calibration(self, calibration: Calibration) -> None:
        """Use a calibration from the next scan on; the new estimator starts from the last pose, if any."""
        posor = Posor(calibration, false_alarm=self.parameters.false_alarm)
        with self._lock:
            if self._last_stream is not None:
                last = None if self._is_lost else self._last_stream.last_scan()
                posor.continue_from(self._posor, None if last is None else scan_of(last.data))
            self._posor, self._calibration, self._stream = posor, calibration, None
            self._source_changes = 0  # the first scan of the new estimator discards the kept scans

    def _respond(self, action: Callable[[Any], str], request: Any, response: Any) -> Any:
        """Run the action of a service; a refusal changes nothing."""
        try:
            response.message = action(request)
        except PosorError as error:
            response.message = str(error)
            self.get_logger().error(response.message)
        else:
            response.success = True
        return response

    def _reload_calibration(self, _request: Trigger.Request) -> str:
        calibration, session_calibration = self._load_calibration()
        frames = self._calibration.frames
        if session_calibration.frames != frames:
            raise CalibrationError(
                f"its frames are {session_calibration.frames.parent} and {session_calibration.frames.child}",
                where=f"calibration file {self.parameters.calibration}",
                expected=f"{frames.parent} and {frames.child} as before, or a restart of the node",
            )
        self._apply_calibration(calibration, session_calibration)
        return f"calibration '{calibration.name}', hash {calibration.content_hash}"

    def _require_scans(self, service: str, expected: str) -> None:
        """Raise ParameterError if no scans come, or the node is inactive: earlier ones may show an earlier position."""
        if silent := self._inputs.silent:
            raise ParameterError(silent, where=service, expected=expected)

    def _count_from_home(self, _request: Trigger.Request) -> str:
        if not self._posor.counts_bumps:
            raise ParameterError(
                "theta is not counted",
                where=f"calibration '{self._calibration.name}'",
                expected="a bumpy ring; ~/set_home of the chain makes poses relative to home",
            )
        with self._lock:
            expected = "sound scans while the joint is at the home mark"
            self._require_scans("home", expected)
            if self._is_lost:
                raise ParameterError("the last scan is LOST", where="home", expected=expected)
            tracker, theta = self._posor.tracker, float(self._posor.tracker["theta"])
            if tracker["counted"] and abs(wrapped(theta)) > 0.5 * self._posor.settings["period"]:
                expected = "the joint at its home mark; if the count is wrong, cleanup and configure of the node first"
                raise ParameterError(f"theta is counted as {theta:.4g} rad", where="home", expected=expected)
            self._count_from_next = True
            if self._stream is not None:
                self._stream.count_from_next()
        return "theta is counted from the next scan, which is taken to be within half a bump of the home mark"

    def _forget_home(self) -> None:
        """Forget that theta is to be counted from the next scan: by now the joint may be elsewhere."""
        self._count_from_next = False
        if self._stream is not None:
            self._stream.count_from_next(stated=False)
        self._inputs.note("home", "the call of ~/home is void, because no sound scan followed it at once")

    def _zero_gap_probes(self, _request: Trigger.Request) -> str:
        """Shift the zero of the gap probes by the most recent scans (thesis 8.3.1)."""
        with self._lock:
            self._require_scans("zero", "sound scans while the target is at home")
            recent = list(self._recent_scans)
        if len(recent) < self.parameters.zero_scans:
            raise ParameterError(
                f"{len(recent)} sound scans so far", where="zero", expected=f"{self.parameters.zero_scans}"
            )
        gap, alpha, beta = self.parameters.home_pose
        scans, dark = Scans.of([scan_of(data) for data in recent]), self._posor.dark_currents
        zero = find_digital_zero(self._calibration, scans, (gap, alpha, beta), dark)
        self._use_calibration(zero.calibration)
        values, sigmas = _format_numbers(zero.shifts.array), _format_numbers(zero.shifts.sigmas)
        shifts = f"zero_shifts: {{value: {values}, sigma: {sigmas}, unit: V}}"
        self._status.update({"zero": shifts})
        text = f"{shifts}, changed by {_format_numbers(zero.changes)} V; in force until the calibration is read again"
        self.get_logger().info(text)
        return text

    def _acknowledge_fault(self, request: Acknowledge.Request) -> str:
        """Release the latched fault where the request and the last scan allow it."""
        with self._lock:
            if not self._posor.has_latch:
                return "there is no latched fault"
            self._require_scans("acknowledge", "sound scans at the release")
            now_s = time.monotonic()
            self._release.check(request.caller, request.reason, now_s)
            last = None if self._stream is None else self._stream.last_lit_scan()
            check_plausible(self._posor, last, self._encoder)
            self._posor.acknowledge()
            self._release.note(now_s)
        text = f"released by {request.caller}: {request.reason}"
        self._status.update({"acknowledged": text})
        self.get_logger().warning(text)
        return "the fault is released; the next scan starts anew"

    def _confirm_theta(self, theta: float, stamp_ns: int) -> None:
        with self._lock:
            self._encoder = EncoderReading(theta, self.parameters.encoder.sigma, stamp_ns)
            self._posor.confirm_theta(theta, self.parameters.encoder.sigma, stamp_ns)

    @staticmethod
    def estimate_scans(deliveries: list[Delivery]) -> Callable[[], None]:
        """Estimate a scan of each of some nodes in one compiled call, and deliver the transforms within this process.

        A chain_node of this process takes the transforms of its joints in that call and publishes its endpoint at once.
        Return what can wait until the endpoint is published: transforms for others, counts, and reports.
        """
        scans = []
        for subscription, data in deliveries:
            if (scan := subscription.attempt(subscription.node.prepare_scan, subscription, data)) is not None:
                scans.append(scan)
        taken = _estimate(scans)
        results = [(scan, scan.subscription.attempt(scan.subscription.node.finish_scan, scan, taken)) for scan in scans]

        def complete_scans() -> None:
            for scan, transform in results:
                if transform is not None:
                    scan.subscription.attempt(scan.subscription.node.complete_scan, scan.stream, scan.data, transform)

        return complete_scans

    def prepare_scan(self, subscription: GroupMember, data: bytes) -> PreparedScan | None:
        """Return a scan for the next run of its stream; None: the scan is dealt with already."""
        if not self.may_publish:
            return None
        inputs, stream = self._inputs, self._stream
        if self._count_from_next and inputs.silent:
            self._forget_home()
        if stream is not None:
            stream.use_effects(used=self._publisher.is_read_whole)
            if not inputs.several and stream.prepare(data, inputs.stamp_limits.now_ns()):
                return PreparedScan(subscription, stream, data, self._publisher.taker)
        self._use_unexpected_scan(data)
        return None

    def finish_scan(self, scan: PreparedScan, taken: bool) -> bytes | None:  # noqa: FBT001  see ``attempt``
        """Return the transform of a prepared scan after the run, delivered within this process.

        ``taken``: chain_node has it already. Empty: nobody else reads it; None: the scan is dealt with already.
        """
        transform: bytes | None
        if taken:
            scan.stream.keep(scan.data)
            stamp_ns, changed, _ = scan.stream.stamp_change_and_missing()
            is_due = self._throttle.is_due(stamp_ns, changed=bool(changed))
            is_read = is_due or self._publisher.is_read_by_others(scan.taker)
            transform = scan.stream.transform() if is_read else b""
        else:
            transform = scan.stream.finish(scan.data)
        if transform is None:
            self._use_unexpected_scan(scan.data)
        elif transform:
            self._publisher.deliver(transform, taken_by=scan.taker if taken else None)
        return transform

    def _use_unexpected_scan(self, data: bytes) -> None:
        """Estimate a scan that is not the expected one, or of which the node expects nothing yet."""
        transform = self._estimate_scan(data)
        if transform is None:
            data = self._open_stream(data)
            transform = self._estimate_scan(data)
        if transform and self._stream is not None:
            self._publisher.deliver(transform)
            self.complete_scan(self._stream, data, transform)

    def _estimate_scan(self, data: bytes) -> bytes | None:
        """Return the transform of a scan, empty for a repeated one; None if there is no stream for it."""
        stream = self._stream
        if stream is None or (identity := stream.identity(data)) is None:
            return None
        if last := stream.last_stamp_and_number():
            kind, text = self._order.describe(identity, last, is_same=stream.is_last(data))
            if kind:
                self._inputs.note(kind, text)
            if kind == REPEATED:
                return b""
        if refusal := self._inputs.refusal(identity[0]):
            return stream.refuse_message(data, refusal)
        return stream.estimate_message(data, self._inputs.stamp_limits.now_ns())

    def _open_stream(self, data: bytes) -> bytes:
        """Make a stream for a scan of another layout; return the scan in plain CDR, empty if it is invalid."""
        try:
            data = schema_of_class(RawScan).normal(data)
            stream = RawScanStream(self._posor, data)
        except TopicError as error:
            self._messages_refused += 1
            self._reported = None
            self._status.report(Level.ERROR, f"no estimate: {error}", {"messages_refused": self._messages_refused})
            return b""
        if self._stream is not None:
            self._recent_scans.clear()
        self._stream = stream
        limits = self._inputs.stamp_limits
        stream.accept_ages(limits.youngest_ns, limits.oldest_ns)
        if self._count_from_next:
            stream.count_from_next()
        return data

    def complete_scan(self, stream: RawScanStream, data: bytes, transform: bytes) -> None:
        """Publish the transform of a scan to other processes, count the scan, and report a change of the status.

        ``transform``: empty: nobody reads it. A sound scan is kept for the digital zero.
        """
        if transform:
            self._publisher.publish_over_dds(transform)
        stamp_ns, changed, missing = stream.stamp_change_and_missing()
        if missing:
            self._inputs.note(*self._order.count_missing(stream.number_of(data), missing))
        if transform and self._throttle.is_due(stamp_ns, changed=bool(changed)):
            self._throttle.publish_due(stamp_ns, transform)
        if stamp_ns:
            self.timing.record(stamp_ns)
        self._scans += 1
        if changed or self._is_lost or self._reported is None:
            self._update_status(stream)
        if not self._is_lost:
            self._recent_scans.append(data)
        if self._count_from_next:
            if self._is_lost:
                self._forget_home()
            self._count_from_next = stream.counts_from_next

    def _update_status(self, stream: RawScanStream) -> None:
        """Handle a scan that is LOST, or whose state, faults or light source differ from those of the scan before.

        The digital zero needs consecutive scans of one light source: a LOST scan or another source discards kept scans.
        """
        state, faults, source_changes = (stream.status[name].item() for name in ("state", "faults", "row_changes"))
        self._last_stream, self._is_lost = stream, state == LOST
        if self._is_lost or source_changes != self._source_changes:
            self._recent_scans.clear()
            self._source_changes = source_changes
        self._scans_lost += self._is_lost
        is_alarm = self._is_lost and self._alarms.add(self._scans)
        is_waiting = waits_to_be_counted(state, faults)
        if is_waiting:
            self._alarms.forget()  # at a wrong bump readings contradict each other
        excess = self._alarms.excess(self._scans)
        if (key := (state, faults, is_alarm or bool(excess))) != self._reported:
            self._reported = key
            level = Level.ERROR if key[2] else Level.WARN if is_waiting else LEVELS.get(State(state), Level.ERROR)
            formatter = partial(_format_status, state, faults, excess, self._counts(), stream.last_scan())
            self._status.report_status_change(level, formatter)

    def _counts(self) -> dict[str, Value]:
        return {"scans": self._scans, "scans_lost": self._scans_lost}

    def _clock_values(self) -> dict[str, Value]:
        """Return period and scatter of the stamps, and the time offset of the scans from the encoder [s]."""
        clocks, (offset, uncertainty) = self._posor.tracker["clocks"], self._posor.time_offset
        period, scatter = float(clocks["period"]), math.sqrt(clocks["variance"])
        values: dict[str, Value] = {"scan_period_s": period, "stamp_scatter_s": scatter}
        if self.parameters.encoder.sigma:
            values |= {"encoder_time_offset_s": offset, "encoder_time_offset_uncertainty_s": uncertainty}
        return values

    def _refresh_status(self) -> None:
        with self._lock:
            if self._last_stream is None:
                return
            counts, last = self._counts() | self._clock_values(), self._last_stream.last_scan()
            if self._reported is not None and self._reported[2]:
                self._reported = None  # the rate of alarms may have become normal
            step_s = float(self._posor.tracker["clocks"]["step"])
        if step_s > 0.0:
            self._stamps.report(Level.WARN, STEPPED.format(step_s))
        else:
            self._stamps.report(Level.OK, "without a step")
        self._inputs.update(self._order.counts)
        self._status.update(_status_values(counts, last))


def _estimate(scans: list[PreparedScan]) -> bool:
    """Estimate prepared scans in one compiled call; return whether chain_node has taken the transforms in it.

    If chain_node raises, all of its subscriptions end, and the transforms are sent to all others.
    """
    run = None
    if scans and (taker := scans[0].taker) is not None and taker.group is not None:
        take, lock = taker.group.take, scans[0].subscription.group.lock
        if take is not None and taker.group.lock is lock:
            run = _attempt(scans, take, scans)
    if run is None:
        RawScanStream.run_prepared(tuple([scan.stream for scan in scans]))
        return False
    return bool(_attempt(scans, run))


def _attempt(scans: list[PreparedScan], step: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a step of chain_node; None: it has raised."""
    try:
        return step(*arguments)
    except Exception as error:  # noqa: BLE001  it ends the program, from the main thread
        for scan in scans:
            if scan.taker is not None:
                scan.taker.fail(error)
        return None


def _format_status(state: int, faults: int, excess: str, counts: dict[str, Value], scan: EstimatedScan) -> StatusText:
    fault_names = str(Fault(faults).name) if faults else "none"
    state_text = NOT_COUNTED if waits_to_be_counted(state, faults) else f"{State(state).name.lower()}: {fault_names}"
    text = "; ".join(filter(None, (state_text, excess)))
    return text, {"faults": fault_names, **_status_values(counts, scan)}


def _status_values(counts: dict[str, Value], scan: EstimatedScan) -> dict[str, Value]:
    """Return the values of a scan in the diagnostics, except for state and faults."""
    return {
        **counts,
        "last_scan": scan.number,
        "reason": scan.reason,
        "residual": scan.residual,
        "redundancy": scan.redundancy,
    }


def _format_numbers(numbers: Iterable[float]) -> str:
    return f"[{', '.join(f'{number:.6g}' for number in numbers)}]"


def main() -> int:
    """Run the node as a program."""
    return run_node(PosorEstimatorNode)
