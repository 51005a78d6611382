"""Compile every kernel once, so that no node has to: ``python -m posor_estimator.core.warm_up``.

Numba keeps the compiled code on disk beside the sources. Without numba there is nothing to do.
"""

from __future__ import annotations

import sys
from typing import get_args

import numpy as np

from posor_estimator.core.chain import Chain
from posor_estimator.core.compiled import COMPILING
from posor_estimator.core.designs import DesignName, design
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.posor import Posor

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
    for name in get_args(DesignName):
        posor = Posor(design(name))
        rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (2, 1))
        scans = scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64))
        if State.LOST in [posor.locate(scans[n]).state for n in range(len(scans))]:
            message = f"design {name} does not locate its own scans"
            raise AssertionError(message)


def main() -> int:
    """Compile and say so."""
    warm_up()
    print("kernels compiled" if COMPILING else "numba is not installed: kernels run uncompiled")
    return 0


if __name__ == "__main__":
    sys.exit(main())
