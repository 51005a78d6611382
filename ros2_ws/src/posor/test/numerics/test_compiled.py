# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Kernels of the library, of numba and in plain Python give the same bits; a library that does not fit is refused."""

from __future__ import annotations

import gc
import importlib
import math
import os
import shutil
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor import kernel_build
from posor.calibration.designs import design
from posor.chain.kinematic_chain import Chain
from posor.estimation import solver as solve
from posor.estimation.posor import Posor
from posor.kernel_examples import ARM, example_stream
from posor.messages.byte_kernels import write_records
from posor.messages.message_stream import estimate_messages
from posor.model.reading_rows import prepare_rows
from posor.numerics.array_types import FloatArray
from posor.numerics.compiled import MODE, bind, bind_in_parts, in_parts, run_in_turn
from posor.numerics.kernel_library import FILE_NAME, NEW_BUILD, PACKAGE, LibraryKernel
from posor.numerics.summary_statistics import FIGURES, figures_of

PROGRAM = Path(__file__).resolve().parent / "kernel_outputs.py"
SHORT = ["golden", "rig"]
OUTPUTS = ["rows", "scans", "arms", "raw", "messages", "bag", *SHORT]


def run(folder: Path, mode: str, *options: str) -> dict[str, FloatArray]:
    file = folder / f"{mode}.npz"
    environ, command = os.environ | {"POSOR_KERNELS": mode}, [str(PROGRAM), str(file), *options]
    subprocess.run([sys.executable, "-W", "error", *command], env=environ, check=True, timeout=1800)
    with np.load(file) as saved:
        return dict(saved)


def test_golden_cases_and_a_bag_have_the_same_bits_in_python_and_in_the_library(tmp_path: Path) -> None:
    plain, fast = (run(tmp_path, mode, "--short") for mode in ("python", "library"))
    assert (str(plain["mode"]), str(fast["mode"])) == ("python", "library")
    for which in SHORT:
        assert np.count_nonzero(np.isfinite(plain[which])) > 100
        np.testing.assert_array_equal(plain[which].view(np.uint64), fast[which].view(np.uint64))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FloatArray]:
    return run(tmp_path_factory.mktemp("plain"), "python")


@pytest.fixture(scope="module", params=["library", "numba"])
def fast(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, FloatArray]:
    found = run(tmp_path_factory.mktemp("fast"), request.param)
    assert found["mode"] == request.param
    return found


def test_the_library_is_used_and_has_every_kernel_that_python_calls() -> None:
    assert MODE == "library"
    for module, names in (kernel_build.JOINT_ENTRIES | kernel_build.ARM_ENTRIES).items():
        for name in names:
            assert isinstance(getattr(importlib.import_module(f"posor.{module}"), name), LibraryKernel), name


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("which", OUTPUTS)
def test_in_every_mode_the_kernels_give_the_same_bits(
    which: str, plain: dict[str, FloatArray], fast: dict[str, FloatArray]
) -> None:
    assert plain[which].shape[0] > 0
    np.testing.assert_array_equal(plain[which].view(np.uint64), fast[which].view(np.uint64))


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_library_that_fuses_operations_gives_other_bits(plain: dict[str, FloatArray], tmp_path: Path) -> None:
    """The control of the test above: LLVM may contract products and sums, as compilers of C do by default."""
    copy = tmp_path / "posor"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    build = tmp_path / "build.py"
    build.write_text(FUSING_BUILD, encoding="utf-8")
    subprocess.run([sys.executable, str(build), str(copy / FILE_NAME)], check=True, timeout=600)
    output, path = tmp_path / "fused.npz", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    environ = os.environ | {"PYTHONPATH": path, "POSOR_KERNELS": "library"}
    subprocess.run([sys.executable, str(PROGRAM), str(output)], env=environ, check=True, timeout=600)
    with np.load(output) as fused:
        same = {
            which for which in OUTPUTS if np.array_equal(plain[which].view(np.uint64), fused[which].view(np.uint64))
        }
    assert same.isdisjoint({*SHORT, "bag", "raw"})


FUSING_BUILD = """
import re, sys
from posor import kernel_build
from posor.calibration.designs import design
from posor.chain.kinematic_chain import Chain
kernel_build.PROCESSOR = "x86-64-v3"
compile_entry = kernel_build.compile_entry
def compile_fusing(*arguments):
    entry = compile_entry(*arguments)
    return entry._replace(text=re.sub(r"= f(mul|add|sub) ", r"= f\\1 contract ", entry.text))
kernel_build.compile_entry = compile_fusing
sys.exit(kernel_build.main())
"""


@pytest.mark.long
def test_the_inputs_reach_every_end_of_the_solver_that_a_scan_can_take(plain: dict[str, FloatArray]) -> None:
    assert {solve.CONVERGED, solve.ILL_CONDITIONED} <= {int(outcome) for outcome in plain["scans"][:, 0]}
    assert np.isfinite(plain["rows"]).all()
    assert not np.isnan(plain["raw"]).any()  # effects of causes that no reading bounds are infinite


SHOWN = "from posor.numerics import compiled\nmain = lambda: print(compiled.MODE, compiled.__file__) or 0\n"


def run_program(folder: Path, **variables: str) -> tuple[int, str, str]:
    """Run a program with the kernels of a copy of the package; return exit code and both outputs."""
    (folder / "shown.py").write_text(SHOWN, encoding="utf-8")
    path = f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    code = "import sys; from posor.lazy_program import LazyProgram; sys.exit(LazyProgram('program', 'shown')())"
    environ = os.environ | {"PYTHONPATH": path} | variables
    done = subprocess.run([sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def test_a_library_of_other_sources_ends_a_program_with_one_sentence(tmp_path: Path) -> None:
    """After an update of the package no process may go on with yesterday's formula."""
    copy = tmp_path / "posor"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    library = next(folder / FILE_NAME for folder in (PACKAGE, PACKAGE.parent) if (folder / FILE_NAME).is_file())
    shutil.copy(library, copy)
    assert run_program(tmp_path) == (0, f"library {copy / 'numerics' / 'compiled.py'}\n", "")
    with (copy / "model" / "gap.py").open("a", encoding="utf-8") as file:
        file.write("# another formula\n")
    sentence = f"program: {copy / FILE_NAME}: was built from other sources; expected {NEW_BUILD}.\n"
    assert run_program(tmp_path) == (1, "", sentence)
    (copy / FILE_NAME).write_bytes(b"no library")
    code, out, err = run_program(tmp_path)
    assert (code, out, err.count("\n")) == (1, "", 1)
    (copy / FILE_NAME).unlink()
    for mode in ("library", "fast"):
        code, out, err = run_program(tmp_path, POSOR_KERNELS=mode)
        assert (code, out) == (1, "")
        assert err.startswith(f"program: POSOR_KERNELS: is '{mode}'")
    assert run_program(tmp_path, POSOR_KERNELS="python")[1].startswith("python")


@pytest.mark.parametrize(
    ("values", "what"),
    [
        (np.array([1.0, 2.0]), "float64"),
        (np.array([1, 2], dtype=np.int32), "int32"),
        (np.array([[1, 2]]), "2 dimensions"),
        (np.arange(6)[::2], "not contiguous"),
    ],
)
def test_an_array_that_a_kernel_does_not_expect_is_refused(values: FloatArray, what: str) -> None:
    """Machine code would read the memory of another type, or memory behind the array."""
    with pytest.raises(TypeError, match=what):
        figures_of(values, 3, np.empty(FIGURES))  # type: ignore[arg-type]


def test_records_of_another_layout_are_refused() -> None:
    with pytest.raises(TypeError, match="prepare_rows received an array of"):
        prepare_rows(np.zeros(1, dtype=[("kind", "i8")]))


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ((np.array([1, 2]), 3), "2 arguments; expected 3"),
        ((np.array([1, 2]), 3, np.empty(FIGURES), 1), "4 arguments; expected 3"),
        ((np.array([1, 2]), 3.5, np.empty(FIGURES)), "float"),
    ],
)
def test_wrong_arguments_are_refused(arguments: tuple[Any, ...], what: str) -> None:
    """A missing argument would be an address of zero."""
    with pytest.raises(TypeError, match=what):
        figures_of(*arguments)


def test_a_bound_kernel_takes_all_of_its_further_arguments() -> None:
    kernel: Any = write_records
    with pytest.raises(TypeError, match="all but integers"):
        kernel.bind((np.zeros(16, dtype=np.uint8),))
    posor = Posor(design("triad_diodes"))
    run = bind(estimate_messages, (posor.model, example_stream()))
    with pytest.raises(TypeError, match="2 further arguments; expected 4"):
        run(0, 0)


def test_arrays_of_a_call_are_released() -> None:
    """Estimates of millions of scans take gigabytes."""
    estimator = Chain(ARM, "endpoint").estimator()
    endpoints = estimator.estimate_all(np.tile(estimator.poses, (3000, 1, 1)), *np.zeros((2, 3000, 1, 6, 6)))
    released = weakref.ref(endpoints.covariances_random)
    del endpoints
    gc.collect()
    assert released() is None


@pytest.mark.parametrize("with_python", [False, True])
def test_kernels_run_in_turn_as_each_by_itself(with_python: bool) -> None:  # noqa: FBT001
    times, expected = [np.arange(3), np.arange(5, 9), np.arange(0)], []
    for each in times:
        out = np.zeros(FIGURES)
        expected.append((figures_of(each, 100, out), *out))
    outs, order = [np.zeros(FIGURES) for _ in times], list[int]()
    kernels = [bind_in_parts(figures_of, (each, 100, out)) for each, out in zip(times, outs, strict=True)]
    assert all(kernel.call for kernel in kernels)
    if with_python:
        kernels.insert(1, in_parts(order.append))
        kernels[1].put((7,))
    run = run_in_turn(kernels)
    for _ in range(2):
        run()
        found = [kernel.results() for kernel in kernels]
    found = [result for result, kernel in zip(found, kernels, strict=True) if kernel.call]
    assert [(result, *out) for result, out in zip(found, outs, strict=True)] == expected
    assert order == [7, 7] * with_python


def test_the_error_of_a_function_run_in_turn_is_raised_by_its_results_only() -> None:
    kernels = [in_parts(each) for each in (math.sqrt, abs)]
    for kernel in kernels:
        kernel.put((-4,))
    run_in_turn(kernels)()
    with pytest.raises(ValueError, match="math domain"):
        kernels[0].results()
    assert kernels[1].results() == 4
