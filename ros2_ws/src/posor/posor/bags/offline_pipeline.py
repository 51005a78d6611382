"""The offline pipeline: from a bag of raw scans to the poses of joints and endpoint, a block at a time.

A bag is not split in time: an estimator starts each scan from the pose before and counts bumps, and the motion of the
beams is followed through time. So one bag is one unit of work; the memory in use does not depend on its size.
"""

from __future__ import annotations

from time import perf_counter, process_time
from typing import TYPE_CHECKING

from posor.bags.arm_estimator import ArmEstimator
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_topics import topics_of
from posor.bags.block_reader import TopicReader, read_blocks
from posor.bags.provenance import custom_data, differences, provenance_of
from posor.bags.reprocess_task import Summary, Task
from posor.bags.result_folder import new_result_folder, writing
from posor.errors import BagError
from posor.messages.raw_scan import RecordedScans

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import Protocol

    from posor.bags.bag_topics import BagTopics
    from posor.bags.block_reader import MessageBlock
    from posor.messages.estimate_arrays import ArmEstimates

    class Output(Protocol):
        """Receives the estimates of a bag, block after block."""

        def write(self, estimates: ArmEstimates) -> None:
            """Write the estimates of a block."""

        def close(self) -> None:
            """Write what belongs at the end."""


def reprocess_bag(task: Task, progress: Callable[[int], object] = lambda _: None) -> Summary:
    """Estimate the joints and the endpoint of a recorded arm, and write the results.

    Args:
        task: Bag, settings and output.
        progress: Called with the number of raw scans that have been processed since its last call.

    Raises:
        PosorError: The bag, a calibration, the chain or the output folder cannot be used. Then nothing exists under
            the name of the output.

    """
    wall, cpu = perf_counter(), process_time()
    estimator = ArmEstimator(task.settings)
    topics = topics_of(task.bag, task.settings.joints)
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
    return Summary(task.bag, task.output, joints, endpoint, topics.left_out, changed, wall_s, cpu_s)


def estimate_bag(bag: Path, topics: BagTopics, estimator: ArmEstimator) -> Iterator[ArmEstimates]:
    """Yield the poses of all joints and of the endpoint, block after block of a bag.

    Args:
        bag: Folder or file.
        topics: Its topics with the joints' raw scans.
        estimator: Of the arm.

    Raises:
        BagError: The bag cannot be read.

    """
    for scans in read_recorded_scans(bag, topics):
        yield estimator.estimate_block(scans)
    estimator.finish()


def read_recorded_scans(bag: Path, topics: BagTopics) -> Iterator[Mapping[str, Sequence[RecordedScans]]]:
    """Yield the raw scans of all joints, block after block; scans with different readings are in separate parts.

    Raises:
        BagError: The bag cannot be read.

    """
    readers = {
        joint: TopicReader(number, topic, topics.schemas[joint], str(bag))
        for number, (joint, topic) in enumerate(topics.raw.items())
    }
    for block in _read_blocks(bag, list(topics.raw.values())):
        yield {
            joint: [RecordedScans.unpack(*part) for part in reader.read_tables(block)]
            for joint, reader in readers.items()
        }


def _read_blocks(bag: Path, topics: Sequence[str]) -> Iterator[MessageBlock]:
    with opened_bag(bag) as reader:
        try:
            yield from read_blocks(reader, topics, str(bag))
        except OSError as error:
            raise BagError(f"cannot be read on, {error.strerror}", where=str(bag)) from error


def _scan_count(estimates: ArmEstimates) -> int:
    return sum(len(joint) for joint in estimates.joints.values())


def _open_output(task: Task, folder: Path, topics: BagTopics, estimator: ArmEstimator) -> Output:
    """Return the output in the requested format; each imports libraries of its own."""
    if task.format == "bag":
        from posor.bags.bag_output import BagOutput  # noqa: PLC0415

        return BagOutput(folder, topics, estimator, provenance_of(task.settings), task.output or folder)
    from posor.bags.table_output import TableOutput  # noqa: PLC0415

    endpoint = estimator.endpoint
    return TableOutput(folder, task.format, list(topics.raw), None if endpoint is None else endpoint.joints)
