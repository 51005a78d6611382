# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""soak: runs a simulated arm in one process for a long time; the exit code is 0 only if nothing is lost or grows.

Every scan has a state on ``endpoint/state``, and a pose unless the state says why not. A tick without a state was
missed by all drivers; a state that names a missing transform belongs to a tick that one driver missed; anything else is
lost. The aims are in ``docs/how_to/fuzz_and_soak.md``.
"""

from __future__ import annotations

import re
import time
from array import array
from collections import Counter
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor.ros_names import ENDPOINT_STATE_TOPIC, ENDPOINT_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_msgs.msg import EndpointState
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from posor_lab.benchmark.tick_statistics import TickWindow
from posor_lab.faults.fault_table import CYCLE_S, IMPERFECTION_PARAMETERS, RATES, write_fault_arm
from posor_lab.harness.message_conversion import is_usable
from posor_lab.lab_output import page_notes
from posor_lab.reports.findings import Finding, Findings, judge
from posor_lab.reports.graph_receiver import GraphReceiver, running_graph
from posor_lab.reports.trial_program import Option, TrialProgram
from posor_lab.soak.process_sample import ProcessSample, growth_mb

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import IntArray

    from posor_lab.faults.fault_table import ArmName
    from posor_lab.reports.graph_receiver import GraphWatch
    from posor_lab.reports.trial_program import Trial

QOS = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)
SEED = 1985  # seed of the motion
SETTLED_POSES = 100  # poses before the run begins
REFRESHES = 3  # diagnostics of each node after the end of the drivers until its totals hold the last scans
SAMPLE_S = 5.0  # time between two samples of the process
SETTLING_NS = 1_000_000_000  # time before the end of the drivers that is not judged: scans under way
_MISSING = "transform missing"


@dataclass(frozen=True)
class SoakFigures:
    """Figures of a run; see ``SoakReceiver.figures`` for those of the scans."""

    seconds: float
    ticks: int  # in the measured time
    ticks_missed: int  # by the driver that missed most
    sent: int  # raw scans of all joints, in the whole run
    transforms: int  # of all joints, in the whole run
    states: int  # ticks with a state of the endpoint
    poses: int  # ticks with a pose
    without_pose: dict[str, int]  # ticks whose state says why there is no pose, by its reason
    lost_scans: int  # raw scans without a transform
    lost_states: int  # ticks without a state that no driver missed
    lost_transforms: int  # transforms that the chain lacked although their driver had sent the scan
    lost_poses: int  # ticks with a pose, or a state that says so, but not both
    samples: tuple[ProcessSample, ...]

    @property
    def lost(self) -> int:
        """Number of lost scans, states, transforms and poses, without missed ticks."""
        return self.lost_scans + self.lost_states + self.lost_transforms + self.lost_poses

    @property
    def growth_mb(self) -> float:
        """Growth of the memory over the samples [MB]."""
        return growth_mb(self.samples)


class SoakReceiver(GraphReceiver):
    """Keeps the stamps of an arm's endpoint, of its states without a pose with their reason, and the diagnostics."""

    def __init__(self, arm: ArmFile) -> None:
        super().__init__("soak")
        self.poses, self.states = array("q"), array("q")
        self.reasons: dict[int, str] = {}
        for kind, topic, on_bytes in (
            (PoseStamped, ENDPOINT_TOPIC, self._on_pose),
            (EndpointState, ENDPOINT_STATE_TOPIC, self._on_state),
        ):
            self.create_subscription(kind, f"/{arm.name}/{topic}", on_bytes, QOS, raw=True)
        self._drivers = [f"/{arm.name}/{joint}/driver_node" for joint in arm.calibrations]
        self._posors = [f"/{arm.name}/{joint}/posor_node" for joint in arm.calibrations]
        self._changes = [self.create_client(ChangeState, f"{driver}/change_state") for driver in self._drivers]

    def _on_pose(self, data: bytes) -> None:
        self.received += 1
        self.poses.append(stamp_ns_of(data[STAMP]))

    def _on_state(self, data: bytes) -> None:
        self.received += 1
        message = deserialize_message(data, EndpointState)
        if message.state == EndpointState.STATE_STALE:  # about the absence of scans, with the stamp of an old one
            return
        self.states.append(stamp := stamp_ns_of(data[STAMP]))
        if not is_usable(message):
            self.reasons[stamp] = message.reason

    def missed(self) -> IntArray:
        """Return the ticks that each driver has missed since its start, (joints,)."""
        return self._totals(self._drivers, "pace", "ticks_missed")

    def _totals(self, nodes: Sequence[str], status: str, key: str) -> IntArray:
        return np.array([int(self.status_value(f"{node}: {status}", key) or 0) for node in nodes])

    def stop_drivers(self, watch: GraphWatch) -> None:
        """Deactivate all drivers and wait for diagnostics that hold the totals."""
        request = ChangeState.Request()
        request.transition.id = Transition.TRANSITION_DEACTIVATE
        answers = [client.call_async(request) for client in self._changes]
        watch.wait(lambda: all(each.done() for each in answers), lambda: "the end of the drivers")
        names = [f"{node}: source" for node in self._drivers] + [f"{node}: estimate" for node in self._posors]
        begin = {name: self.status_count(name) for name in names}
        watch.wait(
            lambda: all(self.status_count(name) >= count + REFRESHES for name, count in begin.items()),
            lambda: "diagnostics",
        )

    def figures(self, window: TickWindow, missed: IntArray, samples: Sequence[ProcessSample]) -> SoakFigures:
        """Return the figures of a time window, and the totals of the run.

        Totals of missed ticks are up to a second old where the window begins: ticks missed just before it may be taken
        for ticks of the window.
        """
        ticks = window.stamps_ns
        has_state, has_pose = (np.isin(ticks, np.array(each)) for each in (self.states, self.poses))
        says_none = np.isin(ticks, np.array(list(self.reasons), dtype=np.int64))
        reasons = Counter(_without_joints(self.reasons[stamp]) for stamp in ticks[says_none].tolist())
        unseen = int(np.count_nonzero(~has_state & ~has_pose))
        missed_by_all = min(unseen, int(missed.min()))
        sent = self._totals(self._drivers, "source", "scans_published")
        estimated = self._totals(self._posors, "estimate", "scans")
        return SoakFigures(
            seconds=(window.end_ns - window.begin_ns) / 1e9,
            ticks=len(ticks),
            ticks_missed=int(missed.max()),
            sent=int(sent.sum()),
            transforms=int(estimated.sum()),
            states=int(has_state.sum()),
            poses=int(has_pose.sum()),
            without_pose=dict(reasons.most_common()),
            lost_scans=int(np.abs(sent - estimated).sum()),
            lost_states=unseen - missed_by_all,
            lost_transforms=max(0, reasons[_MISSING] - int(np.sum(missed - missed_by_all))),
            lost_poses=int(np.count_nonzero(has_pose != (has_state & ~says_none))),
            samples=tuple(samples),
        )


def _without_joints(reason: str) -> str:
    """Return the reason of a state without the names of the joints."""
    if _MISSING in reason:
        return _MISSING
    return "; ".join(sorted(set(re.findall(r"is ([^;]+)", reason)))) or reason


def run_soak(
    name: ArmName,
    seconds: float,
    warm_up: float,
    folder: Path,
    on_sample: Callable[[ProcessSample], None],
    interrupted: Callable[[], bool],
) -> SoakFigures:
    """Run an arm with all nodes in one process, after a warm-up [s], and return its figures.

    It moves as in the fault table, at the same rate. ``on_sample`` is called every ``SAMPLE_S``.

    Raises ProcessError: the process failed, or messages stopped. Raises InterruptedRunError: the user interrupted the
    run.
    """
    arm = write_fault_arm(name, folder / "arm", CYCLE_S, SEED)
    programs = group_programs(arm_programs(arm, driver_parameters=IMPERFECTION_PARAMETERS), "composed", folder)
    receiver = SoakReceiver(arm)
    with running_graph(programs, receiver, folder, "soak", interrupted) as watch:
        (nodes,) = watch.running.values()
        watch.wait(lambda: len(receiver.poses) > SETTLED_POSES, lambda: "endpoint poses")
        watch.wait_for(warm_up)
        begin_ns, begin_s, missed, samples = time.time_ns(), time.monotonic(), receiver.missed(), []
        while True:
            now_s = time.monotonic() - begin_s
            samples.append(ProcessSample.take(nodes.process.pid, now_s))
            on_sample(samples[-1])
            if now_s >= seconds:
                break
            watch.wait_for(min(SAMPLE_S, seconds - now_s))
        window = TickWindow(begin_ns, time.time_ns() - SETTLING_NS, RATES[name])
        receiver.stop_drivers(watch)
        return receiver.figures(window, receiver.missed() - missed, samples)


LINE_S = 300.0  # time between two lines about the process
MOST_GROWTH_MB = 1.0
MIN_SECONDS = 5.0  # the last second of a run is not judged
OPTIONS = (
    Option("--arm", "five_axis", "simulated arm", choices=tuple(RATES)),
    Option("--seconds", 3600.0, "duration after the warm-up [s]", least=MIN_SECONDS),
    Option("--warm-up", 300.0, "time from the first poses to the first sample of memory [s]", least=0.0),
)


def run_program(trial: Trial) -> tuple[Findings, Mapping[str, Any]]:
    """Run the arm; return the findings and the content of the output file."""
    options, next_line_s = trial.options, 0.0

    def on_sample(sample: ProcessSample) -> None:
        nonlocal next_line_s
        if sample.seconds >= next_line_s:
            next_line_s += LINE_S
            text = f"{sample.descriptors} descriptors, {sample.threads} threads"
            trial.progress.line(f"{sample.seconds:.0f} s: {sample.memory_mb:.2f} MB, {text}")

    figures = run_soak(options.arm, options.seconds, options.warm_up, trial.folder, on_sample, trial.interrupted)
    findings = soak_findings(figures)
    summary = {"arm": options.arm, "holds": findings.holds, "lost": figures.lost, "growth_mb": figures.growth_mb}
    return findings, {**summary, **asdict(figures)}


def soak_findings(figures: SoakFigures) -> Findings:
    """Return the verdicts on the figures."""
    first, last = figures.samples[0], figures.samples[-1]
    texts, known = page_notes("soak"), vars(figures)
    found = [
        *(judge(text, **known) for text in texts["figures"]),
        *(Finding(f"no pose, {reason}", f"{count}") for reason, count in figures.without_pose.items()),
        *(Finding.none_of(text, known[name]) for name, text in texts["lost"].items()),
        Finding.judged(
            "growth of the memory",
            f"{figures.growth_mb:.3f} MB",
            f"below {MOST_GROWTH_MB:g} MB",
            holds=figures.growth_mb < MOST_GROWTH_MB,
            remark=f"{first.memory_mb:.2f} MB at the begin, {last.memory_mb:.2f} MB at the end",
        ),
    ]
    for name in ("descriptors", "threads"):
        begin, end = getattr(first, name), getattr(last, name)
        found.append(Finding.judged(f"{name} at the end", f"{end}", f"{begin} at the begin", holds=begin == end))
    return Findings(tuple(found))


DESCRIPTION = "Run a simulated arm in one process for a long time."
PROGRAM = TrialProgram("soak", DESCRIPTION, OPTIONS, run_program, "arm in one process", "build/soak.json")
main = PROGRAM.main
