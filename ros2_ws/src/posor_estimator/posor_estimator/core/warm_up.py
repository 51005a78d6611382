"""Compile every kernel once, so that no node has to: ``python -m posor_estimator.core.warm_up``.

Numba keeps the compiled code on disk beside the sources. Without numba there is nothing to do.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, get_args

import numpy as np

from posor_estimator.core.chain import Chain
from posor_estimator.core.chain_records import ChainRecords, JointColumns, read_records
from posor_estimator.core.columns import Columns
from posor_estimator.core.compiled import COMPILING
from posor_estimator.core.designs import DesignName, design
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels.moments import FIGURES, figures_of
from posor_estimator.core.posor import Posor
from posor_estimator.core.records import Records

if TYPE_CHECKING:
    from posor_estimator.core.chain_lane import ChainLane

ARM = """<robot name="arm"><link name="base"/><link name="plate"/><link name="endpoint"/>
<joint name="joint" type="floating"><parent link="base"/><child link="plate"/></joint>
<joint name="beam" type="fixed"><parent link="plate"/><child link="endpoint"/></joint></robot>"""


def warm_up() -> None:
    """Run each design over two scans, and an arm over one: that compiles every kernel with the types that nodes use."""
    lane = Chain(ARM, "endpoint").lane()
    if not lane.run():
        message = "an arm of one joint has no endpoint"
        raise AssertionError(message)
    lane.find_relative_to(lane.pose)
    warm_up_chain_records(lane)
    for name in get_args(DesignName):
        posor = Posor(design(name))
        rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (2, 1))
        scans = scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64))
        if State.LOST in [posor.locate(scans[n]).state for n in range(len(scans))]:
            message = f"design {name} does not locate its own scans"
            raise AssertionError(message)
    warm_up_records()
    figures_of(np.array([1, 2]), 3, np.empty(FIGURES))


def warm_up_chain_records(lane: ChainLane) -> None:
    """Run an arm of one joint over a measurement that is a row of numbers, alone and as one of many."""
    columns = JointColumns(pose=0, theta=56, covariance=64, state=352, size=360)
    records = ChainRecords(lane, [columns])
    numbers = records.rows.view(np.float64)
    numbers[0, 6] = 1.0
    read_records(records.rows, columns, 0, np.empty((1, 1, 7)), np.empty((1, 1, 6, 6)), np.empty((1, 1)))
    if records.run(0) != State.OK:
        message = "a joint's measurement in a row gives no endpoint"
        raise AssertionError(message)


def warm_up_records() -> None:
    """Run a design over two scans that are rows of numbers, one by one and both at once."""
    posor = Posor(design("triad_diodes"))
    rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (2, 1))
    scans = scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64))
    raw, out = np.zeros((2, 19)), np.zeros((2, 56))
    raw.view(np.int32)[:, 1] = scans.stamps_ns
    raw[:, 3:6], raw[:, 6:14] = scans.gap_voltages, scans.diode_currents.reshape(2, -1)
    raw[:, 14], raw[:, 15] = scans.supply_voltages, scans.temperatures
    raw.view(np.uint8)[:, 128:130] = scans.lit_sources
    columns = Columns(
        seconds=0,
        number=8,
        status=16,
        gaps=(24, 3),
        rings=(136, 0),
        currents=(48, 8),
        supply=112,
        temperature=120,
        lit=(128, 2),
        home=1,
        to_stamp=0,
        to_number=8,
        to_status=16,
        to_redundancy=20,
        to_faults=24,
        to_pose=32,
        to_native=88,
        to_residual=136,
        to_covariance=144,
        kind=2,
    )
    records = Records(posor, columns, np.zeros(8 * out.shape[1], dtype=np.uint8))
    records.locate(raw.view(np.uint8), out.view(np.uint8))
    row, pose = raw[:1].view(np.uint8).copy(), out[:1].view(np.uint8).copy()
    lane = records.lane(row, pose, np.zeros((2, row.shape[1]), dtype=np.uint8))
    posor.reset()
    for scan in raw.view(np.uint8):
        row[0] = scan
        lane.run()
    if pose.tobytes() != out[1].tobytes() or records.outcome[0] == State.LOST:
        message = "scans in rows are not located, one by one as at once"
        raise AssertionError(message)


def main() -> int:
    """Compile and say so."""
    warm_up()
    print("kernels compiled" if COMPILING else "numba is not installed: kernels run uncompiled")
    return 0


if __name__ == "__main__":
    sys.exit(main())
