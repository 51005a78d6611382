# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the nodes: threads of linear algebra, and libraries that take long to load."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from posor.lazy_program import BLAS_THREADS
from posor_bringup.arms import load_checked_arm

COUNT = """\
import os

import numpy as np

np.ones((500, 500)) @ np.ones((500, 500))
main = lambda: print(len(os.listdir("/proc/self/task"))) or 0
"""
RUN = "import sys; from posor_estimator.estimator_programs import {0}; {0}.module = 'shown'; sys.exit({0}())"


def test_garbage_is_collected_again_after_the_import(tmp_path: Path) -> None:
    (tmp_path / "shown.py").write_text(
        "import gc\nmain = lambda: print(gc.isenabled(), gc.get_freeze_count() > 0) or 0\n"
    )
    environ = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    command = [sys.executable, "-c", RUN.format("posor_node")]
    assert subprocess.run(command, env=environ, capture_output=True, text=True, check=True).stdout == "True True\n"


OPEN_ARM = """\
import sys
from pathlib import Path

import posor_estimator.chain_node, posor_estimator.posor_node
from posor.chain.arm_file import load_arm_file
from posor.estimation.posor import Posor

arm = load_arm_file(Path(sys.argv[1]))
for joint in arm.calibrations:
    Posor(arm.calibration(joint))
arm.chain()
print(*{"scipy", "numba"} & set(sys.modules))
"""


def test_nodes_of_an_arm_load_neither_scipy_nor_numba() -> None:
    environ = {name: value for name, value in os.environ.items() if name != "POSOR_KERNELS"}
    command = [sys.executable, "-c", OPEN_ARM, str(load_checked_arm("six_axis").path)]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


@pytest.mark.parametrize("program", ["posor_node", "chain_node", "correction_node", "compose"])
def test_a_node_has_one_thread_of_linear_algebra_unless_the_caller_asks_for_more(program: str, tmp_path: Path) -> None:
    (tmp_path / "shown.py").write_text(COUNT, encoding="utf-8")
    environ = {name: value for name, value in os.environ.items() if name not in BLAS_THREADS}
    environ["PYTHONPATH"] = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    for given, threads in (({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, min(2, os.cpu_count() or 1))):
        done = subprocess.run(
            [sys.executable, "-c", RUN.format(program)], env=environ | given, capture_output=True, text=True, check=True
        )
        assert int(done.stdout) == threads
