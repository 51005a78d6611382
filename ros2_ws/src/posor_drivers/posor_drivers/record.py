"""record: writes topics into a rosbag2 bag (MCAP) until SIGINT or SIGTERM.

Each message is kept as the bytes that came over the wire. Prints ``ready: ...`` once every named topic is connected,
and when it ends, ``closed ...`` with the number of messages of each topic.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from posor_estimator.errors import BagError, ParameterError
from posor_estimator.ros.main import exit_code_of, own_arguments, ros, spin
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from posor_drivers.bag_writer import BagWriter
from posor_drivers.recorder import Recorder

if TYPE_CHECKING:
    from collections.abc import Sequence


class _Parser(argparse.ArgumentParser):
    """Reports a wrong command line the way every other error is reported."""

    def error(self, message: str) -> NoReturn:
        raise ParameterError(message, where="record", expected="--output FOLDER and --topics TOPIC... or --all")


def _parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = _Parser(prog="record", description="Record topics into a rosbag2 bag until interrupted.")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="the bag; must not exist yet")
    choice = parser.add_mutually_exclusive_group(required=True)
    choice.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="topics to record")
    choice.add_argument("--all", action="store_true", help="record every topic that appears")
    options = parser.parse_args(list(arguments))
    for topic in options.topics:
        try:
            validate_topic_name(topic)
        except InvalidTopicNameException as error:
            reason = str(error).split(":")[1].split("\n")[0].strip()
            raise ParameterError(f"'{topic}' is no topic name, {reason}", where="record") from None
    return options


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _record(arguments: Sequence[str]) -> None:
    with ros(arguments) as stop:
        options = _parse(own_arguments(arguments))
        with BagWriter(options.output) as writer:
            recorder = Recorder(writer, options.topics, _say)
            try:
                spin(recorder, lambda: stop.requested or recorder.failure is not None)
            finally:
                recorder.finish()
        counts = ", ".join(f"{name} {count}" for name, count in writer.counts.items()) or "no topics"
        _say(f"closed {options.output}: {counts}")
        if recorder.failure is not None:
            raise recorder.failure
        if shortcomings := recorder.shortcomings():
            raise BagError("; ".join(shortcomings), where=str(options.output))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the recorder as a program."""
    return exit_code_of(lambda: _record(sys.argv if arguments is None else arguments))
