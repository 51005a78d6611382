# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Guides a person, or a robot program, through the steps of a commissioning, and records the arm meanwhile.

Each step is announced, begins and ends; ``posor_msgs/CommissioningStep`` says so on a topic that is recorded beside the
raw scans. What is recorded is checked afterwards, exactly as a bag of another day.
"""

from __future__ import annotations

import select
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event, Thread
from typing import TYPE_CHECKING

from posor.bags.bag_writer import BagWriter
from posor.errors import BagError, TopicError
from posor.lazy_program import EXIT_INTERRUPTED
from posor_drivers.recorder import Recorder
from posor_msgs.msg import CommissioningStep
from posor_ros.node_program import spin_until
from posor_ros.qos import RELIABLE_QOS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from posor_calibration.commissioning.plan import Step
    from posor_ros.node_program import StopSignal

POLL_S = 0.05
CONNECT_S = 10.0  # longest time until all topics are there
TAIL_S = 0.3  # time after the last step in which its scans arrive


class InterruptedGuideError(TopicError):
    """The commissioning was interrupted; what was recorded is no commissioning."""

    exit_code = EXIT_INTERRUPTED


@dataclass(frozen=True)
class StepTimes:
    """Times of the steps [s]."""

    rest: float  # of a step in which the arm rests
    sweep: float  # of a sweep without a person
    automatic: float  # from an announcement to the begin of the step, for robot programs; 0: a person presses Enter


class Guide:
    """Announces steps and waits for them."""

    def __init__(self, recorder: Recorder, topic: str, stop: StopSignal, times: StepTimes) -> None:
        """Open the topic of the steps."""
        self._recorder, self._stop, self._times = recorder, stop, times
        self._publisher = recorder.create_publisher(CommissioningStep, topic, RELIABLE_QOS)

    def wait_for_topics(self, required: Collection[str]) -> None:
        """Wait until all topics are recorded. Raises TopicError: a topic does not appear."""
        end = time.monotonic() + CONNECT_S
        while missing := [name for name in required if not self._is_recorded(name)]:
            if time.monotonic() > end:
                what = f"no publisher of {', '.join(missing)} within {CONNECT_S:g} s"
                raise TopicError(what, where="commission", expected="a running arm, as 'posor bringup ARM' starts it")
            self._sleep(POLL_S)

    def _is_recorded(self, name: str) -> bool:
        return name in self._recorder.topics and self._recorder.topics[name].matched

    def run(self, steps: Sequence[Step]) -> None:
        """Go through the steps. Raises InterruptedGuideError: a signal, or the end of the standard input."""
        for number, step in enumerate(steps, start=1):
            print(f"[{number}/{len(steps)}] {step.instruction}", flush=True)
            self._publish(step, CommissioningStep.PHASE_ANNOUNCED)
            self._wait("    then press Enter", self._times.automatic)
            self._publish(step, CommissioningStep.PHASE_BEGIN)
            if step.action == "sweep":
                self._wait("    move it; at its end press Enter", self._times.sweep)
            else:
                self._sleep(self._times.rest)
            self._publish(step, CommissioningStep.PHASE_END)
        self._sleep(TAIL_S)

    def _publish(self, step: Step, phase: int) -> None:
        message = CommissioningStep(phase=phase, **step._asdict())
        message.header.stamp = self._recorder.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _wait(self, prompt: str, automatic_s: float) -> None:
        """Wait for Enter, or for a time if there is no person."""
        if self._times.automatic:
            self._sleep(automatic_s)
            return
        print(prompt, flush=True)
        while not select.select([sys.stdin], [], [], POLL_S)[0]:
            self._check()
        if not sys.stdin.readline():
            raise InterruptedGuideError("the standard input has ended", where="commission", expected="Enter")

    def _sleep(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._check()
            time.sleep(min(left, POLL_S))

    def _check(self) -> None:
        if self._stop.requested:
            raise InterruptedGuideError("interrupted", where="commission")
        if self._recorder.failure is not None:
            raise self._recorder.failure


@contextmanager
def recording(
    bag: Path, topics: Collection[str], required: Collection[str], custom_data: Mapping[str, str]
) -> Iterator[Recorder]:
    """Record topics into a new bag meanwhile, in a thread.

    Raises BagError: the bag exists already, cannot be written, or messages of a required topic were lost.
    """
    done = Event()
    with BagWriter(bag, custom_data) as writer:
        recorder = Recorder(writer, sorted(topics), lambda _: None)
        thread = Thread(target=spin_until, args=(recorder, done.is_set), name="recorder")
        thread.start()
        try:
            yield recorder
        finally:
            done.set()
            thread.join()
            recorder.finish()
    if recorder.failure is not None:
        raise recorder.failure
    lost = [f"{topic.lost} messages of {name}" for name, topic in recorder.topics.items() if topic.lost]
    if lost and any(recorder.topics[name].lost for name in required):
        raise BagError(f"{', '.join(lost)} were lost", where=str(bag), expected="a less busy machine")
