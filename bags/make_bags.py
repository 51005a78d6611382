"""Make the bags of the 1985 tests YMO, YZMO and ZMO from the recorded tables.

``make data`` runs it, in the workspace's environment; with an argument it makes the bags in that folder. Existing bags
are replaced, each only once the new one is whole. The scans come from the driver's own source ``table``, the bags from
the recorder's own writer; the same bytes on every run.
"""

from __future__ import annotations

import sys
from pathlib import Path

from posor_drivers.bag_writer import replacement
from posor_drivers.offered_qos import kept_in_bag
from posor_drivers.sources.table import TableParameters, TableSource
from posor_estimator.errors import PosorError
from posor_estimator.ros.message_types import MessageTypes
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import RAW_TOPIC, RELIABLE_QOS, sensor_qos

HERE = Path(__file__).resolve().parent
TABLES = HERE.parent / "data/slocum1985"
TESTS = ("ymo", "yzmo", "zmo")
JOINT = "/joint1"


def make_bag(table: Path, bag: Path) -> None:
    """Write the bag of one recorded test."""
    types = MessageTypes()
    source = TableSource(TableParameters(path=str(table)), types)
    names = {}
    with replacement(bag) as writer:
        for topic in source.open():
            scans = topic.name == RAW_TOPIC
            names[topic.name] = f"{JOINT}/{RAW_TOPIC}" if scans else topic.name
            qos = sensor_qos(NodeParameters()) if scans else RELIABLE_QOS
            definition = types.definition(topic.type_name)
            writer.add_topic(names[topic.name], topic.type_name, definition, [kept_in_bag(qos)])
        for message in source.messages():
            writer.write(names[message.topic], message.time_ns, message.data)


def main(folder: Path) -> None:
    """Make all bags in ``folder``."""
    for test in TESTS:
        make_bag(TABLES / f"{test}_input.csv", folder / test)
        print(f"made {folder / test}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
    except PosorError as complaint:
        sys.exit(str(complaint))
