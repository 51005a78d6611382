# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""One use of every kernel of ``kernel_build.PARTS`` with the types that programs use, for the build and for tests."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import numpy as np

from posor.calibration.designs import DesignName, design
from posor.chain.beam_vibration import Oscillators, follow_reading, write_vibration
from posor.chain.endpoint_predictor import EndpointPredictor
from posor.chain.joint_measurements import VIBRATION, JointRowLayout, JointRows
from posor.chain.kinematic_chain import Chain
from posor.estimation.estimate_scan import begin_scan_estimate, solve_and_check, write_lost
from posor.estimation.fault_model import EFFECT
from posor.estimation.forward import scans_at
from posor.estimation.linearise import linearise_scan
from posor.estimation.posor import Posor
from posor.messages import byte_kernels
from posor.messages.joint_transform import TRANSFORM_LAYOUT, pack_rows
from posor.messages.message_stream import (
    STATUS,
    MessageEstimator,
    MessageStream,
    begin_message,
    copy_transform,
    end_message,
)
from posor.messages.message_table import MessageRows
from posor.messages.raw_scan import RAW_SCAN_LAYOUT, unpack_rows
from posor.model.fault import State
from posor.model.reading_rows import differentiate_rows, evaluate_poses, prepare_rows, turn_rows
from posor.node_parameters import EncodersParameters
from posor.numerics.compiled import record_view
from posor.numerics.summary_statistics import FIGURES, figures_of

if TYPE_CHECKING:
    from posor.model.scan import Scans

ROW_BYTES = 1024
FIELD_BYTES = {  # bytes of the fields of a message that are longer than eight bytes
    "gap_voltages": 64,
    "ring_voltages": 64,
    "diode_currents": 128,
    "exposure_offsets": 256,
    "pose": 56,
    "native": 48,
    "covariance_random": 288,
    "covariance_systematic": 288,
    "stamp_shift": 48,
}
EXAMPLE_ROW = JointRowLayout(
    pose=32,
    native=88,
    covariance_random=144,
    covariance_systematic=432,
    shared=0,
    effects=0,
    stamp_shift=720,
    state=21,
    size=ROW_BYTES,
)

ARM = """<robot name="arm"><link name="base"/><link name="plate"/><link name="endpoint"/>
<joint name="joint" type="floating"><parent link="base"/><child link="plate"/></joint>
<joint name="beam" type="fixed"><parent link="plate"/><child link="endpoint"/></joint></robot>"""


def use_joint_kernels() -> None:
    """Call the kernels of joints: two scans of each design and one message."""
    for name in get_args(DesignName):
        posor = Posor(design(name))
        rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (2, 1))
        scans = scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64))
        first = posor.estimate(scans[0]).state
        estimates = posor.estimate_all(scans.part(1, 2), fault_effects=True)
        if State.LOST in [first, *estimates.states]:
            message = f"design {name} does not estimate its own scans"
            raise AssertionError(message)
        stream = example_stream()
        MessageEstimator(posor, stream).estimate_rows()
        begin_message(posor.model, stream, 0, 0, 0)
        end_message(posor.model, stream, 0)
        copy_transform(stream, JointRows.allocate([EXAMPLE_ROW]), 0)
        unpack_rows(stream.raw, stream.raw_layout, posor.model.workspace["scan"])
        records, layout = record_view(estimates._records), stream.transform_layout
        pack_rows(records, stream.effects, layout, stream.template, stream.transforms)
        _use_sensors(posor, scans)
        _use_single_steps(posor, scans)


def use_arm_kernels() -> None:
    """Call the kernels of arms and bags: one arm, one chunk of a bag."""
    _use_chain()
    _use_bytes()
    figures_of(np.array([1, 2]), 3, np.empty(FIGURES))


def _use_sensors(posor: Posor, scans: Scans) -> None:
    """Linearise and predict the readings of scans outside of the estimator."""
    stack, pose = posor.stack, np.eye(3)
    stack.linearise(scans)
    stack.residual_jacobian(scans[0], pose, np.zeros(3))
    differentiate_rows(stack.reading_rows, pose, np.zeros(3))
    evaluate_poses(stack.reading_rows, np.zeros((1, 1), dtype=np.int64), pose[None], np.zeros((1, 3)))


def _use_single_steps(posor: Posor, scans: Scans) -> None:
    """Take the steps of a scan that a POSOR with sensors in plain Python takes one by one."""
    model, records = posor.model, record_view(scans._records)
    workspace = model.workspace[0]
    estimate = record_view(model.workspace["estimate"])[0]
    linearise_scan(model, records[0], estimate)
    begin_scan_estimate(model, records[0], estimate, True)  # noqa: FBT003  kernels take no keywords
    prepare_rows(record_view(workspace["rows"]))
    turn_rows(record_view(workspace["rows"]), 0.1)
    solve_and_check(model, records[0], False, estimate)  # noqa: FBT003  kernels take no keywords
    write_lost(estimate, 0)


def _use_bytes() -> None:
    """Index, copy, gather and write one message of a chunk; what is read may be read-only."""
    data, two = np.frombuffer(bytes(64), dtype=np.uint8), np.frombuffer(bytes(16), dtype=np.int64)
    messages, out = np.frombuffer(bytes(32), dtype=np.uint8).reshape(2, 16)[:, :8], np.zeros(8, dtype=np.uint8)
    byte_kernels.index_messages(data, np.zeros(2**16, dtype=np.int64), *np.zeros((4, 3), dtype=np.int64))
    byte_kernels.copy_messages(data, two, two, out)
    rows, words = np.zeros((2, 16), dtype=np.uint8), np.zeros((2, 2), dtype=np.uint64)
    byte_kernels.gather_rows(data, two, two, words, rows.view(np.uint64), rows[:, 4:12])
    byte_kernels.write_records(data[:16], two, messages, 0, np.zeros((2, 24), np.uint8), np.zeros((2, 2), np.int64))


def example_stream(count: int = 1) -> MessageStream:
    """Return a stream of messages of zeros with room for all readings of a raw scan; the readings are not used."""
    raw_layout, transform_layout = np.zeros(1, dtype=RAW_SCAN_LAYOUT), np.zeros(1, dtype=TRANSFORM_LAYOUT)
    for layout in (raw_layout, transform_layout):
        offset = 0
        for name in layout.dtype.names or ():
            if not name.endswith(("count", "bits")):
                layout[name], offset = offset, offset + FIELD_BYTES.get(name, 8)
    raw, transforms = (MessageRows.of(np.zeros((count, ROW_BYTES), dtype=np.uint8)) for _ in range(2))
    words = np.zeros(ROW_BYTES // 4, dtype=np.int32)  # no bit is decisive: every row has this layout
    status = record_view(np.zeros(1, dtype=STATUS))
    template, effects = np.zeros(ROW_BYTES // 8), np.zeros((1, 0, EFFECT), dtype=np.float32)
    layouts = record_view(raw_layout), record_view(transform_layout)
    return MessageStream(raw, layouts[0], words, words, transforms, layouts[1], template, effects, status)


def _use_chain() -> None:
    """Find the endpoint of an arm of one joint, and one more from a row of bytes."""
    chain = Chain(ARM, "endpoint")
    estimator = chain.estimator(row_layouts=[EXAMPLE_ROW])
    if not estimator.estimate():
        message = "an arm of one joint has no endpoint"
        raise AssertionError(message)
    estimator.estimate_relative_to(estimator.pose)
    estimator.bound_error(relative=True)
    rows = np.zeros((1, ROW_BYTES), dtype=np.uint8)
    rows.view(np.float64)[0, 10] = 1.0  # w of the quaternion
    estimator.rows[0] = rows[0]
    estimator.estimate_rows(0)
    oscillators = Oscillators.allocate(1)
    follow_reading(oscillators, np.zeros(3), 0, 1)
    write_vibration(oscillators, np.zeros((1, 1), dtype=VIBRATION), 0, 1)
    predictor = EndpointPredictor(chain, EncodersParameters(sigma=(1e-6,)))
    predictor.use_row_layout(0, EXAMPLE_ROW)
    predictor.read(1, np.zeros(1))
    predictor.use_transform(0, 1)
    predictor.use_row(0, 1)
