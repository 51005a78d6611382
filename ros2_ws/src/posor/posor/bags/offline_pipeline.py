# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The offline pipeline: from a bag of raw scans to the poses of joints and endpoint, a block at a time.

A bag is not split in time: an estimator starts each scan from the pose before and counts bumps, and the motion of the
beams is followed through time. So one bag is one unit of work; the memory in use does not depend on its size.
"""

from __future__ import annotations

from time import perf_counter, process_time
from typing import TYPE_CHECKING

import numpy as np

from posor.bags.arm_estimator import ArmEstimator, RecordedTemperature
from posor.bags.bag_reader import log_once, opened_bag, scan_schema
from posor.bags.block_reader import read_blocks
from posor.bags.message_block import TopicReader
from posor.bags.provenance import custom_data, differences, provenance_of
from posor.bags.reprocess_task import BagTopics, Settings, Summary, Task, common_namespace
from posor.bags.result_folder import new_result_folder
from posor.bags.result_output import BagOutput, TableOutput
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.errors import BagError, checked_path
from posor.estimation.estimate import Estimates
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates
from posor.messages.message_definitions import installed_schema
from posor.messages.raw_scan import RecordedScans
from posor.model.fault import USABLE_STATES, Fault, State
from posor.numerics.stamps import times_ns
from posor.output_files import writing
from posor.ros_names import RAW_SCAN, RAW_TOPIC, TEMPERATURE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection

    from posor.bags.message_block import MessageBlock
    from posor.bags.reprocess_task import JointSettings


def topics_of(
    bag: Path, joints: Mapping[str, JointSettings], thermometers: Mapping[str, str] | None = None, *, option: str = ""
) -> BagTopics:
    """Return the topics of a bag after checking them; of several that a joint may have, that of the arm.

    ``thermometers``: names of the arm's thermometers and ends of their topics; ``option``: of the program, that states
    the topic of a joint, for errors. Raises BagError: the bag cannot be read, a joint has no scans, a joint or a
    thermometer may have several topics, or a topic has another type.
    """
    where = str(bag)
    with opened_bag(bag, log_notes=False) as reader:
        connections = list(reader.connections)
        raw = {joint: each.topic or _topic(joint, each, connections, where, option) for joint, each in joints.items()}
        schemas = {}
        for joint, topic in raw.items():
            schemas[joint] = scan_schema(connections, topic, where)
            twice = [other for other, same in raw.items() if same == topic and other != joint]
            if twice:
                raise BagError(
                    f"topic {topic} is taken for the scans of {joint} and of {twice[0]}",
                    where=where,
                    expected="a topic for each joint",
                )
        own = [connection for connection in connections if connection.topic in raw.values()]
        scans = {connection.topic for connection in connections if connection.msgtype == RAW_SCAN}
        offered = getattr(own[0].ext, "offered_qos_profiles", [])
        arm = common_namespace(raw)
        ends = (thermometers or {}).items()
        temperatures = {name: _temperature_topic(arm, end, connections, where) for name, end in ends}
        unread = [f"there are no readings of thermometer '{name}'" for name, topic in temperatures.items() if not topic]
        return BagTopics(
            raw,
            schemas,
            tuple(sorted(scans - set(raw.values()))),
            list(offered[:1]),
            sum(connection.msgcount for connection in own),
            (*reader.notes(), *_other_arms(joints, raw, scans, where), *_other_name(joints, raw), *unread),
            {name: topic for name, topic in temperatures.items() if topic},
        )


def _other_arms(joints: Mapping[str, JointSettings], raw: Mapping[str, str], scans: set[str], where: str) -> list[str]:
    """Return a sentence on the topics of other arms with the same joints, if there are any.

    Raises BagError: another joint has scans of another arm only, which must not be mixed.
    """
    free = {joint: settings for joint, settings in joints.items() if not settings.topic}
    ends = tuple(f"/{joint}/{RAW_TOPIC}" for joint in free)
    others = sorted(topic for topic in scans - set(raw.values()) if topic.endswith(ends))
    for joint, settings in free.items() if others else ():
        if raw[joint] != settings.own_topic:
            what = f"scans of joint {joint} are on {raw[joint]} only, those of other joints on topics of the arm, too"
            raise BagError(what, where=where, expected=f"scans of one arm, such as {settings.own_topic}")
    return [f"scans of the arm's own topics are used, those on {', '.join(others)} are left out"] if others else []


def _other_name(joints: Mapping[str, JointSettings], raw: Mapping[str, str]) -> list[str]:
    """Return a sentence on scans that an arm of another name has published, if there are any."""
    for joint, settings in joints.items():
        expected, found = (topic.split("/")[-3:-2] for topic in (settings.own_topic, raw[joint]))
        if settings.own_topic and not settings.topic and found not in (expected, [""]):
            return [f"the scans of {joint} are on {raw[joint]}; the files are those of an arm '{expected[0]}'"]
    return []


def _topic(joint: str, settings: JointSettings, connections: Sequence[Connection], where: str, option: str) -> str:
    names = sorted({connection.topic for connection in connections if connection.msgtype == RAW_SCAN})
    end = f"/{joint}/{RAW_TOPIC}"
    found = [name for name in names if name.endswith(end)]
    others = {each.topic: each.msgtype for each in connections if each.topic.endswith(end) and not found}
    if len(found) == 1:
        return found[0]
    if settings.own_topic in found:
        return settings.own_topic
    or_option = f", or {option} {joint}=TOPIC" if option else ""
    if found:
        what = f"scans of joint {joint} may be on {', '.join(found)}"
        expected = "one of these topics" + (f", or {settings.own_topic}, that of the arm" if settings.own_topic else "")
        expected += or_option
    elif others:
        (topic, kind), *_ = others.items()
        what, expected = f"topic {topic} has the type {kind}", f"{RAW_SCAN}{or_option}"
    elif names:
        what = f"there are no scans of joint {joint} on ...{end}"
        expected = f"one of {', '.join(names)}"
    else:
        what, expected = f"there are no raw scans of joint {joint}, nor of any other", "a bag of recorded raw scans"
    raise BagError(what, where=where, expected=expected)


def _temperature_topic(arm: str, end: str, connections: Sequence[Connection], where: str) -> str:
    """Return the topic of a thermometer, of several that of the arm of the scans; empty: there is no such topic."""
    found = sorted({each.topic for each in connections if each.msgtype == TEMPERATURE and each.topic.endswith(end)})
    if arm + end in found:
        return arm + end
    if len(found) > 1:
        what = f"readings of one thermometer may be on {', '.join(found)}"
        raise BagError(what, where=where, expected=f"one of these topics, or {arm}{end}")
    return found[0] if found else ""


def reprocess_bag(task: Task, progress: Callable[[int], object] = lambda _: None) -> Summary:
    """Estimate the joints and the endpoint of a recorded arm, and write the results.

    ``progress``: called with the number of raw scans that have been processed since its last call. Raises PosorError:
    the bag, a calibration, the chain or the output folder cannot be used. Then nothing exists under the name of the
    output.
    """
    wall, cpu = perf_counter(), process_time()
    estimator = ArmEstimator(task.settings)
    topics = topics_of(task.bag, task.settings.joints, estimator.thermometers, option="--topic")
    if task.output is None:
        for estimates in estimate_bag(task.bag, topics, estimator):
            progress(_scan_count(estimates))
    else:
        with new_result_folder(task.output, task.run, force=task.force) as folder:
            with writing(task.output):
                output = _open_output(task, folder, topics, estimator)
            for estimates in estimate_bag(task.bag, topics, estimator):
                with writing(task.output):
                    output.write(estimates)
                progress(_scan_count(estimates))
            with writing(task.output):
                output.close()
    joints, endpoint = estimator.summarise()
    wall_s, cpu_s = perf_counter() - wall, process_time() - cpu
    changed = differences(custom_data(task.bag), task.settings)
    notes = (*topics.notes, *estimator.notes())
    return Summary(task.bag, task.output, joints, endpoint, topics.left_out, changed, notes, wall_s, cpu_s)


def estimate_bag(bag: Path, topics: BagTopics, estimator: ArmEstimator) -> Iterator[ArmEstimates]:
    """Yield the poses of all joints and of the endpoint, block after block of a bag.

    ``topics``: its topics with the joints' raw scans. Raises BagError: the bag cannot be read.
    """
    for scans, readings in read_recorded_scans(bag, topics):
        yield estimator.estimate_block(scans, readings)
    estimator.finish()


def read_recorded_scans(
    bag: Path, topics: BagTopics
) -> Iterator[tuple[Mapping[str, Sequence[RecordedScans]], Sequence[RecordedTemperature]]]:
    """Yield the raw scans of all joints and the readings of thermometers, block after block.

    Scans with different readings are in separate parts. Raises BagError: the bag cannot be read.
    """
    readers = {
        joint: TopicReader(number, topic, topics.schemas[joint], str(bag))
        for number, (joint, topic) in enumerate(topics.raw.items())
    }
    schema = installed_schema(TEMPERATURE)
    thermometers = {
        name: TopicReader(len(readers) + number, topic, schema, str(bag))
        for number, (name, topic) in enumerate(topics.temperatures.items())
    }
    for block in _read_blocks(bag, [*topics.raw.values(), *topics.temperatures.values()]):
        scans = {
            joint: [RecordedScans.unpack(*part) for part in reader.read_tables(block)]
            for joint, reader in readers.items()
        }
        yield scans, [reading for name, each in thermometers.items() for reading in _readings(name, each, block)]


def _readings(name: str, reader: TopicReader, block: MessageBlock) -> Iterator[RecordedTemperature]:
    for _, _, table in reader.read_tables(block):
        stamps = times_ns(table["header.stamp.sec"].astype(np.int64), table["header.stamp.nanosec"].astype(np.int64))
        frame = table.layout.strings["header.frame_id"]
        for stamp_ns, celsius in zip(stamps.tolist(), table["temperature"].tolist(), strict=True):
            yield RecordedTemperature(name, stamp_ns, celsius, frame)


def _read_blocks(bag: Path, topics: Sequence[str]) -> Iterator[MessageBlock]:
    with opened_bag(bag, log_notes=False) as reader:
        try:
            yield from read_blocks(reader, topics, str(bag))
        except OSError as error:
            raise BagError(f"cannot be read on, {error.strerror}", where=str(bag)) from error


def _scan_count(estimates: ArmEstimates) -> int:
    return sum(len(joint) for joint in estimates.joints.values())


def _open_output(task: Task, folder: Path, topics: BagTopics, estimator: ArmEstimator) -> BagOutput | TableOutput:
    if task.format == "bag":
        return BagOutput(folder, topics, estimator, provenance_of(task.settings), task.output or folder)
    endpoint = estimator.endpoint
    return TableOutput(folder, task.format, list(topics.raw), None if endpoint is None else endpoint.joints)


def _unusable_scans(joints: Mapping[str, Estimates]) -> list[str]:
    """Return a sentence on scans without a usable pose, if any: how many of each joint, and why the first has none."""
    counts = []
    for name, estimates in joints.items():
        unusable = np.flatnonzero(~np.isin(estimates.states, USABLE_STATES))
        if unusable.size:
            fault, state = (int(each[unusable[0]]) for each in (estimates.faults, estimates.states))
            why = (Fault(fault) or State(state)).name  # an UNCOUNTED scan may have no fault
            counts.append(f"{unusable.size:,} of {len(estimates):,} of {name} (the first {why})")
    return [f"scans without a usable pose: {', '.join(counts)}"] if counts else []


class Arm(ArmFile):
    """An arm file with its paths resolved, which estimates recorded scans."""

    def estimate(self, bag: Path | str, *, false_alarm: float | None = None) -> ArmEstimates:
        """Return the poses and covariances of all joints and of the endpoint, as the nodes would have published them.

        What was left out of the bag or is not as recorded is logged, and in the ``notes`` of the result.

        Args:
            bag: Folder with metadata.yaml, or a single .mcap or .db3 file, with scans on topics ``.../<joint>/raw``.
            false_alarm: Probability that the chi-square test rejects a correct scan; None: as the arm file states; 0:
                it rejects no scan.

        Raises:
            ParameterError: ``false_alarm`` is not a probability.
            PosorError: The bag, a calibration or the kinematic chain cannot be used.

        """
        path = checked_path(bag, "Arm.estimate", "the path of a bag")
        settings = Settings.of_arm(self).with_false_alarm(false_alarm)
        estimator = ArmEstimator(settings)
        topics = topics_of(path, settings.joints, estimator.thermometers)
        parts = list(estimate_bag(path, topics, estimator))
        joints = {name: Estimates.concatenate([part.joints[name] for part in parts]) for name in settings.joints}
        notes = (*topics.notes, *_unusable_scans(joints), *estimator.notes(), *differences(custom_data(path), settings))
        for note in notes:
            log_once(f"{path}: {note}")
        endpoint = EndpointEstimates.concatenate([part.endpoint for part in parts])
        kelvins = {} if estimator.endpoint is None else estimator.endpoint.kelvins
        return ArmEstimates(joints, endpoint, parts[0].chain, notes, kelvins)

    def __repr__(self) -> str:
        return f"<Arm {self.name} of {self.path}: {', '.join(self.calibrations)}>"


def load_arm(path: Path | str) -> Arm:
    """Read an arm file, given by its path, its folder or the name of an installed arm.

    The files that it names are read by ``Arm.estimate``.

    Raises:
        ParameterError: The argument is not a path, or there is no such arm.
        CalibrationError: The file cannot be read, is not YAML, or has invalid content.

    """
    return Arm(**vars(load_arm_file(checked_path(path, "load_arm", "the path of an arm file"))))
