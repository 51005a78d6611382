"""Make the bags of the 1985 tests YMO, YZMO and ZMO from the recorded tables.

``make data`` runs it in the environment of the workspace; an optional argument is the output folder. An existing bag is
replaced when the new one is complete. The scans come from the driver's source ``table``, the bags from the recorder's
writer; every run gives the same bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from posor.bags.bag_writer import replace_bag
from posor.errors import PosorError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_TOPIC
from posor_drivers.sources.table_source import TableParameters, TableSource
from posor_ros.qos import RELIABLE_QOS, SENSOR_QOS

HERE = Path(__file__).resolve().parent
TABLES = HERE.parent / "data/slocum1985"
TESTS = ("ymo", "yzmo", "zmo")
JOINT = "/joint1"


def make_bag(table: Path, bag: Path) -> None:
    """Write the bag of one recorded test."""
    types = MessageTypes()
    source = TableSource(TableParameters(path=str(table)), types)
    bag_topics = {}
    with replace_bag(bag) as writer:
        for topic in source.open():
            is_raw = topic.name == RAW_TOPIC
            bag_topics[topic.name] = f"{JOINT}/{RAW_TOPIC}" if is_raw else topic.name
            qos = SENSOR_QOS if is_raw else RELIABLE_QOS
            definition = types.definition(topic.type_name)
            writer.add_topic(bag_topics[topic.name], topic.type_name, definition, [qos])
        for message in source.read_messages():
            writer.write(bag_topics[message.topic], message.time_ns, message.data)


def main(folder: Path) -> None:
    """Make all bags in ``folder``."""
    for test in TESTS:
        make_bag(TABLES / f"{test}_input.csv", folder / test)
        print(f"made {folder / test}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
    except PosorError as error:
        sys.exit(str(error))
