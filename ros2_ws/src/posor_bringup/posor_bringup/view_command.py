# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""view: shows a running arm, or a bag of one, on a web page of this host until SIGINT or SIGTERM.

The program joins the graph as the node ``view`` without publishers. DDS keeps the newest messages of each topic; a loop
takes the messages ten times a second while a browser shows the page, otherwise twice, so that events and history go on.
"""

from __future__ import annotations

import sys
import time
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from posor.arm_names import describe_argument
from posor.numerics.stamps import NS
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor_ros.node_program import non_ros_arguments, ros_context

from posor_bringup.arms import load_checked_arm
from posor_bringup.bringup_options import add_namespace
from posor_bringup.view_geometry import ArmGeometry
from posor_bringup.view_history import POINTS
from posor_bringup.view_messages import BLOCK_S, LEAD_S, ArmTopics, BagTopics, LiveTopics, MessageStore
from posor_bringup.view_observation import Observer
from posor_bringup.view_page import ViewPage
from posor_bringup.view_record import WINDOWS_S, ArmRecord

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable, Sequence

    from posor.chain.arm_file import ArmFile
    from posor_ros.node_program import StopSignal

    from posor_bringup.view_geometry import DrawnArm
    from posor_bringup.view_messages import StateChange
    from posor_bringup.view_observation import Observation

PERIOD_S, REST_PERIOD_S = 0.1, 0.5
"""Time between two drawings, and between two observations while no browser shows the page."""
PORT = 8085
MAX_PORT = 65535


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or its value is invalid."""
    parser = CommandLineParser(prog="posor view", description="Show an arm on a web page of this host until Ctrl-C.")
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    add_namespace(parser)
    parser.add_argument("--bag", type=Path, metavar="PATH", help="replay this bag; default: the running arm")
    text = f"port of the page; 0: any free port; default: {PORT}"
    parser.add_argument("--port", type=whole_number_from(0, MAX_PORT), default=PORT, metavar="N", help=text)
    return parser.parse_args(list(arguments))


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    _view(sys.argv if arguments is None else arguments)
    return 0


def _view(arguments: Sequence[str]) -> None:
    options = parse_options(non_ros_arguments(arguments))
    arm = load_checked_arm(options.arm, options.namespace)
    geometry = ArmGeometry(arm)
    with ros_context(arguments) as stop:
        if options.bag is not None:
            _replay_bag(arm, geometry, options, stop)
        else:
            _follow_arm(arm, geometry, options, stop)


def _follow_arm(arm: ArmFile, geometry: ArmGeometry, options: Namespace, stop: StopSignal) -> None:
    topics = ArmTopics(arm, throttled=True)
    store = MessageStore(arm.namespace, topics.types)
    observer = Observer(topics, store, geometry.joints, arm)
    record = ArmRecord(geometry.joints, tuple(WINDOWS_S.values()))
    with (
        closing(ViewPage(arm.name, geometry, options.port, record)) as page,
        closing(LiveTopics(store, topics)) as live,
    ):
        _announce(arm, page)
        while not stop.requested:
            begin_s, is_shown = time.monotonic(), page.has_clients
            now_s = live.take()
            observation = observer.observe(now_s, time.time_ns())
            drawn = draw_observation(geometry, observation)
            _record(record, observer, store.take_changes())
            record.add(observation, drawn)
            if not is_shown:
                page.rest()
            elif page.is_frozen:
                page.show_frozen()
            else:
                page.update(observation, drawn)
            page.wait((PERIOD_S if is_shown else REST_PERIOD_S) - (time.monotonic() - begin_s))


def _replay_bag(arm: ArmFile, geometry: ArmGeometry, options: Namespace, stop: StopSignal) -> None:
    print(f"{arm.name}: reading {options.bag}", flush=True)
    with TemporaryDirectory() as folder:
        bag = BagTopics(options.bag, arm, Path(folder))
        observer = Observer(bag.topics, bag.store, geometry.joints, arm)
        record = read_record(bag, observer, geometry)
        with closing(ViewPage(arm.name, geometry, options.port, record, (bag.begin_ns, bag.end_ns))) as page:
            _announce(arm, page)
            while not stop.requested:
                begin_s = time.monotonic()
                if page.has_clients:
                    observation = _observe_bag(bag, observer, page.replay_position(PERIOD_S))
                    page.update(observation, draw_observation(geometry, observation))
                page.wait(PERIOD_S - (time.monotonic() - begin_s))


def read_record(bag: BagTopics, observer: Observer, geometry: ArmGeometry) -> ArmRecord:
    """Return the record of a bag: all changes of the state, and the charts from begin to end.

    Raises BagError: the bag is damaged.
    """
    record = ArmRecord(geometry.joints, [max(bag.duration_s, POINTS * PERIOD_S)])
    changes = bag.states()
    change = next(changes, None)
    step_s = bag.duration_s / POINTS
    for position_s in np.linspace(0.0, bag.duration_s, POINTS + 1):
        observation = _observe_bag(bag, observer, position_s, BLOCK_S if step_s < LEAD_S else 0.0)
        while change is not None and change.received_ns <= observation.time_ns:
            _record(record, observer, (change,))
            change = next(changes, None)
        record.add(observation, draw_observation(geometry, observation))
    bag.store.take_changes()
    return record


def _observe_bag(bag: BagTopics, observer: Observer, position_s: float, ahead_s: float = BLOCK_S) -> Observation:
    bag.seek(position_s, ahead_s)
    return observer.observe(position_s, bag.begin_ns + round(position_s * NS))


def _record(record: ArmRecord, observer: Observer, changes: Iterable[StateChange]) -> None:
    for change in changes:
        state, causes = observer.state_of(change.values)
        record.add_state(change.received_ns, state, causes, change.values["identity"])


def draw_observation(geometry: ArmGeometry, observation: Observation) -> DrawnArm | None:
    """Return the arm of the scan of an observation; None: there is none."""
    scan, endpoint = observation.scan, observation.endpoint
    return None if scan is None or endpoint is None else geometry.draw(scan, endpoint)


def _announce(arm: ArmFile, page: ViewPage) -> None:
    print(f"{arm.name}: page at {page.address}; Ctrl-C ends it", flush=True)
