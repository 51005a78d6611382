from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from posor.estimation import solver as solve
from posor.numerics.array_types import FloatArray
from posor.numerics.compiled import PACKAGE, cache_folder

PROGRAM = Path(__file__).resolve().parent / "kernel_outputs.py"
NUMBA = importlib.util.find_spec("numba") is not None


def run(folder: Path, *, compiled: bool) -> dict[str, FloatArray]:
    file = folder / f"compiled_{compiled}.npz"
    environ = os.environ | {"POSOR_COMPILE": str(int(compiled))}
    subprocess.run([sys.executable, "-W", "error", str(PROGRAM), str(file)], env=environ, check=True, timeout=110)
    with np.load(file) as saved:
        return dict(saved)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FloatArray]:
    return run(tmp_path_factory.mktemp("plain"), compiled=False)


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FloatArray]:
    return run(tmp_path_factory.mktemp("fast"), compiled=True)


@pytest.mark.long
def test_the_environment_variable_leaves_kernels_uncompiled(plain: dict[str, FloatArray]) -> None:
    assert not plain["compiling"]


@pytest.mark.long
def test_kernels_are_compiled_where_numba_is_installed(fast: dict[str, FloatArray]) -> None:
    assert bool(fast["compiling"]) == NUMBA


@pytest.mark.long
@pytest.mark.parametrize("which", ["rows", "scans", "arms", "raw", "messages"])
def test_compiled_or_not_the_kernels_give_the_same_bits(
    which: str, plain: dict[str, FloatArray], fast: dict[str, FloatArray]
) -> None:
    assert plain[which].shape[0] > 0
    np.testing.assert_array_equal(plain[which].view(np.uint64), fast[which].view(np.uint64))


@pytest.mark.long
def test_the_inputs_reach_every_end_of_the_solver_that_a_scan_can_take(plain: dict[str, FloatArray]) -> None:
    assert {solve.CONVERGED, solve.ILL_CONDITIONED} <= {int(outcome) for outcome in plain["scans"][:, 0]}
    assert np.isfinite(plain["rows"]).all()
    assert np.isfinite(plain["raw"]).all()


PROBE_OVER_PLANE = """
import numpy as np
from posor.model.reading_rows import ROW, evaluate_rows, prepare_rows
row = np.zeros(1, dtype=ROW)
row["axis"][0, 2], row["plane_point"][0, 2] = 1.0, 0.001
prepare_rows(row)
print(evaluate_rows(row, np.eye(3), np.zeros(3))[0][0])
"""


@pytest.mark.long
def test_copies_of_the_package_share_machine_code_until_a_kernel_that_it_calls_changes(tmp_path: Path) -> None:
    """After an update of the package no process may go on with yesterday's formula."""
    copy, cache = tmp_path / "posor", tmp_path / "cache"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    environ = {name: value for name, value in os.environ.items() if name != "POSOR_COMPILE"}

    def read(variables: dict[str, str]) -> float:
        command = [sys.executable, "-c", PROBE_OVER_PLANE]
        run = subprocess.run(command, env=variables, check=True, capture_output=True, text=True, timeout=110)
        return float(run.stdout)

    def machine_code() -> list[Path]:
        return sorted(cache.rglob("*.nbc"))

    assert read(environ) == 0.001
    if (kernels := Path(cache_folder())).is_dir():
        shutil.copytree(kernels, cache / kernels.name)
    code = machine_code()
    assert bool(code) == NUMBA
    environ["NUMBA_CACHE_DIR"] = str(cache)
    environ["PYTHONPATH"] = f"{tmp_path}{os.pathsep}{environ.get('PYTHONPATH', '')}"
    assert read(environ) == 0.001
    assert machine_code() == code
    kernel = copy / "model" / "gap.py"
    text = kernel.read_text(encoding="utf-8")
    assert "    return reading\n" in text
    kernel.write_text(text.replace("    return reading\n", "    return 2.0 * reading\n"), encoding="utf-8")
    assert read(environ) == 0.002
    assert (len(machine_code()) > len(code)) == NUMBA


def test_machine_code_is_kept_where_only_the_user_can_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = Path(cache_folder())
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o777)
    assert Path(cache_folder()) == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    refuge = Path(cache_folder())
    assert refuge.parent != tmp_path
    assert refuge.stat().st_mode & 0o777 == 0o700
    refuge.rmdir()
    folder.unlink()
    if os.getuid() == 0:
        folder.mkdir()
        os.chown(folder, 12345, 12345)
        refuge = Path(cache_folder())
        assert refuge.parent != tmp_path
        refuge.rmdir()
