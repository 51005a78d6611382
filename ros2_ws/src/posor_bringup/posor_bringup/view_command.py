"""view: shows a running arm, or a bag of one, on a web page of this host until SIGINT or SIGTERM.

The program joins the graph as the node ``view`` without publishers. DDS keeps the newest messages of each topic; a loop
takes the messages ten times a second, and only while a browser shows the page.
"""

from __future__ import annotations

import sys
import time
from argparse import ArgumentTypeError
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor_ros.node_program import non_ros_arguments, ros_context

from posor_bringup.arms import installed_arms, load_checked_arm
from posor_bringup.view_geometry import ArmGeometry
from posor_bringup.view_messages import ArmTopics, BagTopics, LiveTopics, MessageStore
from posor_bringup.view_observation import Observer
from posor_bringup.view_page import ViewPage

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Sequence

    from posor.chain.arm_file import ArmFile
    from posor_ros.node_program import StopSignal

    from posor_bringup.view_observation import Observation

PERIOD_S = 0.1  # time between two drawings
PORT = 8085
MAX_PORT = 65535


def _port(text: str) -> int:
    if not (text.isdecimal() and int(text) <= MAX_PORT):
        raise ArgumentTypeError(f"'{text}' is not a port, 0 to {MAX_PORT}")
    return int(text)


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or its value is invalid."""
    parser = CommandLineParser(prog="posor view", description="Show an arm on a web page of this host until Ctrl-C.")
    parser.add_argument(
        "arm", metavar="ARM", help=f"path of an arm file, or name of an installed arm: {', '.join(installed_arms())}"
    )
    parser.add_argument("--bag", type=Path, metavar="PATH", help="replay this bag; default: the running arm")
    text = f"port of the page; 0: any free port; default: {PORT}"
    parser.add_argument("--port", type=_port, default=PORT, metavar="N", help=text)
    return parser.parse_args(list(arguments))


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    _view(sys.argv if arguments is None else arguments)
    return 0


def _view(arguments: Sequence[str]) -> None:
    options = parse_options(non_ros_arguments(arguments))
    arm = load_checked_arm(options.arm)
    geometry = ArmGeometry(arm)
    with ros_context(arguments) as stop:
        if options.bag is not None:
            _replay_bag(arm, geometry, options, stop)
        else:
            _follow_arm(arm, geometry, options, stop)


def _follow_arm(arm: ArmFile, geometry: ArmGeometry, options: Namespace, stop: StopSignal) -> None:
    topics = ArmTopics(arm)
    store = MessageStore(arm.name, topics.types)
    observer = Observer(topics, store, geometry.joints)
    with closing(ViewPage(arm.name, geometry, options.port, None)) as page, closing(LiveTopics(store, topics)) as live:
        _announce(arm, page)

        def draw() -> None:
            live.subscribe()
            now_s = live.take()
            if page.is_frozen:
                page.show_frozen()
            else:
                _draw(page, geometry, observer.observe(now_s))

        _repeat(draw, page, stop, live.unsubscribe)


def _replay_bag(arm: ArmFile, geometry: ArmGeometry, options: Namespace, stop: StopSignal) -> None:
    bag = BagTopics(options.bag, arm)
    observer = Observer(bag.topics, bag.store, geometry.joints)
    with closing(ViewPage(arm.name, geometry, options.port, bag.duration_s)) as page:
        _announce(arm, page)

        def draw() -> None:
            position_s = page.replay_position(PERIOD_S)
            bag.seek(position_s)
            _draw(page, geometry, observer.observe(position_s))

        _repeat(draw, page, stop, lambda: None)


def _announce(arm: ArmFile, page: ViewPage) -> None:
    print(f"{arm.name}: page at {page.address}; Ctrl-C ends it", flush=True)


def _draw(page: ViewPage, geometry: ArmGeometry, observation: Observation) -> None:
    scan, endpoint = observation.scan, observation.endpoint
    page.update(observation, None if scan is None or endpoint is None else geometry.draw(scan, endpoint))


def _repeat(draw: Callable[[], None], page: ViewPage, stop: StopSignal, rest: Callable[[], None]) -> None:
    """Draw in every period in which a browser shows the page; otherwise rest."""
    while not stop.requested:
        begin_s = time.monotonic()
        (draw if page.has_clients else rest)()
        time.sleep(max(0.0, PERIOD_S - (time.monotonic() - begin_s)))


if __name__ == "__main__":
    sys.exit(main())
