"""One bag from raw scans to results, a block at a time, so that memory is bounded whatever the bag's size.

A bag is not split in time: an estimator starts each scan from the pose before and counts bumps, and the beams' motion
is followed through time. So the unit of work is a bag.
"""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import TYPE_CHECKING

from posor_msgs.msg import RawScan

from posor_estimator.bulk.blocks import blocks
from posor_estimator.bulk.pieces import TopicReader
from posor_estimator.chain_node import ChainParameters
from posor_estimator.core.chain import load_chain
from posor_estimator.errors import BagError
from posor_estimator.reprocess.bag_output import BagOutput, EndpointTopics
from posor_estimator.reprocess.endpoint import EndpointReprocessor
from posor_estimator.reprocess.joint import JointReprocessor
from posor_estimator.reprocess.joints import Joints
from posor_estimator.reprocess.output import Output, Told, made
from posor_estimator.reprocess.task import EndpointSummary, JointSummary, Settings, Summary, Task
from posor_estimator.reprocess.topics import BagTopics, topics_of
from posor_estimator.ros.bag_reader import opened_bag
from posor_estimator.ros.cdr import Schema
from posor_estimator.ros.parameters import validate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from posor_estimator.bulk.block import Block
    from posor_estimator.bulk.layout import TableLayout


def reprocess(task: Task, progress: Callable[[int], object] = lambda _: None) -> Summary:
    """Reprocess one bag.

    Args:
        task: What to do.
        progress: Told how many raw scans have been done since it was told last.

    Raises:
        PosorError: The bag, a calibration, the chain or the place for the results cannot be used. Nothing is left then
            under the name of the results.

    """
    wall, cpu = perf_counter(), process_time()
    settings = task.settings
    joints = {
        name: JointReprocessor(joint.load(), settings.covariance, settings.false_alarm)
        for name, joint in settings.joints.items()
    }
    layouts = {name: joint.layout for name, joint in joints.items()}
    together = Joints(joints)
    endpoint = _endpoint(settings, layouts)
    topics = topics_of(task.bag, settings.joints)
    where = str(task.bag)
    readers = {
        name: TopicReader(number, topic, Schema.of(RawScan), where)
        for number, (name, topic) in enumerate(topics.raw.items())
    }
    with ExitStack() as stack:
        output = None
        if task.output is not None:
            folder = stack.enter_context(made(task.output, task.run, force=task.force))
            output = Told(task.output, partial(_output, task, folder, topics, endpoint))
        for block in _blocks(task.bag, list(topics.raw.values())):
            transforms = together.transforms({name: readers[name].pieces(block) for name in joints})
            endpoints = None if endpoint is None else endpoint.endpoints(transforms)
            if output is not None:
                output.write(transforms, endpoints)
            progress(len(block))
        if endpoint is not None:
            endpoint.joiner.finish()
        if output is not None:
            output.close()
    return Summary(
        bag=task.bag,
        output=task.output,
        joints={name: _of_joint(name, joint, endpoint) for name, joint in joints.items()},
        endpoint=None if endpoint is None else _of_endpoint(endpoint),
        left_out=topics.left_out,
        wall_s=perf_counter() - wall,
        cpu_s=process_time() - cpu,
    )


def _blocks(bag: Path, topics: Sequence[str]) -> Iterator[Block]:
    with opened_bag(bag) as reader:
        try:
            yield from blocks(reader, topics, str(bag))
        except OSError as error:
            raise BagError(f"cannot be read on, {error.strerror}", where=str(bag)) from error


def _endpoint(settings: Settings, layouts: Mapping[str, TableLayout]) -> EndpointReprocessor | None:
    if settings.chain is None:
        return None
    parameters = validate(ChainParameters, dict(settings.chain), node="chain_node")
    beams = Path(parameters.beams) if parameters.beams else None
    chain = load_chain(Path(parameters.urdf), parameters.endpoint_frame, beams)
    return EndpointReprocessor(chain, parameters, layouts)


def _output(
    task: Task,
    folder: Path,
    topics: BagTopics,
    endpoint: EndpointReprocessor | None,
) -> Output:
    joints = None if endpoint is None else endpoint.joints
    if task.format == "bag":
        said = None if endpoint is None else EndpointTopics(topics.namespace, endpoint.frame, endpoint.joints)
        return BagOutput(folder, topics.transforms, said, topics.offered)
    from posor_estimator.reprocess.table_output import TableOutput  # noqa: PLC0415  pyarrow takes time to import

    return TableOutput(folder, task.format, list(topics.raw), joints)


def _of_joint(name: str, joint: JointReprocessor, endpoint: EndpointReprocessor | None) -> JointSummary:
    if endpoint is None or name not in endpoint.joints:
        return JointSummary(joint.scans, joint.lost, dict(joint.faults))
    missing, refused = endpoint.joiner.missing[name], endpoint.refused[name]
    return JointSummary(joint.scans, joint.lost, dict(joint.faults), missing, refused)


def _of_endpoint(endpoint: EndpointReprocessor) -> EndpointSummary:
    return EndpointSummary(endpoint.poses, endpoint.degraded, endpoint.unusable, endpoint.joiner.incomplete)
