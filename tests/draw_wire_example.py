"""The example of draw wires for its tests: built and installed as a user would, and what its POSOR reads at a pose."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.estimation.forward import scans_at
from posor.model.native_coordinates import rotation_from_native
from posor.sensors.base import PlainSensor
from posor_lab.harness.random_poses import TICK_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.estimation.posor import Posor
    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scan, Scans
    from posor.numerics.array_types import FloatArray

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "posor_draw_wire"
WIRES = 4


@dataclass(frozen=True)
class Overlay:
    """The example as colcon has installed it, in a workspace of its own on top of this one."""

    install: Path

    def command(self, command: Sequence[str]) -> list[str]:
        """Return a command that runs another one with the overlay sourced."""
        return ["/bin/sh", "-c", '. "$0" && exec "$@"', str(self.install / "local_setup.sh"), *command]

    @property
    def calibration(self) -> Path:
        """The example's installed calibration file."""
        return self.install / "posor_draw_wire" / "share" / "posor_draw_wire" / "config" / "triad_draw_wire.yaml"


def built(home: Path) -> Overlay:
    """Build the example below a folder and install it there."""
    folders = {name: str(home / name) for name in ("build", "install", "log")}
    done = subprocess.run(
        [
            *(sys.executable, "-m", "colcon", "--log-base", folders["log"], "build"),
            *("--base-paths", str(EXAMPLE), "--build-base", folders["build"], "--install-base", folders["install"]),
        ],
        cwd=home,
        env={**os.environ, "COLCON_DEFAULTS_FILE": os.devnull},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return Overlay(home / "install")


def wires_of(stack: Stack) -> PlainSensor:
    [sensor] = [sensor for sensor in stack.sensors if isinstance(sensor, PlainSensor)]
    return sensor


def poses(count: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw poses: leans to 4 mrad, theta to 0.2 rad, 1 mm across, gaps of 0.5 to 1 mm."""
    native = random.uniform(-1.0, 1.0, (count, 3)) * [0.004, 0.004, 0.2]
    across = random.uniform(-1e-3, 1e-3, (count, 2))
    along = random.uniform(0.5e-3, 1.0e-3, count)
    return np.array([rotation_from_native(*angles) for angles in native]), np.column_stack([across, along])


def read_by(
    stack: Stack, rotations: FloatArray, translations: FloatArray, noise: np.random.Generator | None = None
) -> Scans:
    """Return what a stack reads at poses; the wires' voltages by the inverse of their linearisation."""
    count = len(rotations)
    scans = scans_at(stack, rotations, translations, np.arange(1, count + 1, dtype=np.int64) * TICK_NS, noise=noise)
    wires = wires_of(stack)
    lengths = np.array([wires.predict(r, t)[0] for r, t in zip(rotations, translations, strict=True)])
    offset, slope = wires.parameter_values[-2 * WIRES :].reshape(WIRES, 2).T
    volts = (lengths - offset) / slope
    if noise is not None:
        volts += 2e-4 * noise.normal(size=volts.shape)  # as the calibration file says
    return scans.with_fields({"ring_voltages": volts})


def one_scan(posor: Posor) -> tuple[Scan, FloatArray, FloatArray]:
    rotation, translation = rotation_from_native(2e-3, -1e-3, 0.12), np.array([3e-4, -2e-4, 0.7e-3])
    return read_by(posor.stack, rotation[None], translation[None])[0], rotation, translation


def fourth_order(function: Callable[[float], FloatArray], step: float) -> FloatArray:
    """Return d function(x)/dx at zero by central differences."""
    near, far = function(step) - function(-step), function(2.0 * step) - function(-2.0 * step)
    return np.asarray((8.0 * near - far) / (12.0 * step))
