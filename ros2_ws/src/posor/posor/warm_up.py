"""Compile every kernel once, so that no node has to: ``python -m posor.warm_up``.

Numba keeps the compiled code on disk. Without numba there is nothing to do. Of several processes that start at the same
time, as the nodes of a graph do, the first one compiles and the others wait.
"""

from __future__ import annotations

import sys
from fcntl import LOCK_EX, flock
from typing import get_args

import numpy as np

from posor.calibration.designs import DesignName, design
from posor.chain.joint_measurements import JointRowLayout
from posor.chain.kinematic_chain import Chain
from posor.compilation import completion_mark
from posor.estimation.fault_model import EFFECT
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.messages.joint_transform import TRANSFORM_LAYOUT, pack_rows
from posor.messages.message_stream import STATUS, MessageEstimator, MessageStream
from posor.messages.message_table import MessageRows
from posor.messages.raw_scan import RAW_SCAN_LAYOUT, unpack_rows
from posor.model.fault import State
from posor.numerics.compiled import record_view
from posor.numerics.summary_statistics import FIGURES, figures_of

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

ARM = """<robot name="arm"><link name="base"/><link name="plate"/><link name="endpoint"/>
<joint name="joint" type="floating"><parent link="base"/><child link="plate"/></joint>
<joint name="beam" type="fixed"><parent link="plate"/><child link="endpoint"/></joint></robot>"""


def warm_up() -> None:
    """Compile every kernel with the types that nodes use: two scans of each design, one message, one arm."""
    for name in get_args(DesignName):
        posor = Posor(design(name))
        rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (2, 1))
        scans = scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64))
        first = posor.estimate(scans[0]).state
        estimates = posor.estimate_all(scans.part(1, 2))
        states = [first, *estimates.states]
        if State.LOST in states:
            message = f"design {name} does not estimate its own scans"
            raise AssertionError(message)
        stream = example_stream()
        MessageEstimator(posor, stream).estimate_rows()
        unpack_rows(stream.raw, stream.raw_layout, posor.model.workspace["scan"])
        records, layout = record_view(estimates._records), stream.transform_layout
        pack_rows(records, stream.effects, layout, stream.template, stream.transforms)
    warm_up_chain()
    figures_of(np.array([1, 2]), 3, np.empty(FIGURES))


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


def warm_up_chain() -> None:
    """Find the endpoint of an arm of one joint, and one more from a row of bytes."""
    layout = JointRowLayout(
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
    estimator = Chain(ARM, "endpoint").estimator(row_layouts=[layout])
    if not estimator.estimate():
        message = "an arm of one joint has no endpoint"
        raise AssertionError(message)
    estimator.estimate_relative_to(estimator.pose)
    estimator.bound_error(relative=True)
    rows = np.zeros((1, ROW_BYTES), dtype=np.uint8)
    rows.view(np.float64)[0, 10] = 1.0  # w of the quaternion
    estimator.rows[0] = rows[0]
    estimator.estimate_rows(0)


def main() -> int:
    """Compile and report it."""
    mark = completion_mark()
    if mark is None:
        warm_up()
        print("numba is not installed: kernels run uncompiled")
        return 0
    mark.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with mark.with_name("compiling").open("w") as lock:
        flock(lock, LOCK_EX)
        if not mark.exists():
            warm_up()
            mark.touch()
    print("kernels compiled")
    return 0


if __name__ == "__main__":
    sys.exit(main())
