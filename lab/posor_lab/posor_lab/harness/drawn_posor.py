# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated POSOR with parameters drawn from the uncertainties of its calibration, and a pose reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor.bags.recording import Recording, Track
from posor.calibration.designs import design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import native_from_rotation, rotation_from_native
from posor.model.scan import STATED_HOME
from posor_calibration.calibration_parameters import FreeParameters

from posor_lab.harness.random_poses import readable, readable_poses

if TYPE_CHECKING:
    from posor.calibration.designs import DesignName
    from posor.numerics.array_types import FloatArray, IntArray
    from posor_calibration.least_squares import Fit

ALONG, ABOUT = 2e-7, 2e-6  # standard uncertainty of the simulated reference [m, rad]


def pose_track(poses: list[pin.SE3], stamps: IntArray, sigmas: tuple[float, float] = (ALONG, ABOUT)) -> Track:
    """Return poses as the track of a reference; ``sigmas``: along [m] and about [rad] every axis."""
    values = np.array([[*pose.translation, *pin.Quaternion(pose.rotation).coeffs()] for pose in poses])
    signs = np.where(np.sum(values[:, 3:] * values[0, 3:], axis=1) < 0.0, -1.0, 1.0)
    values[:, 3:] *= signs[:, None]
    return Track(stamps, values, np.array([*[sigmas[0]] * 3, *[0.5 * sigmas[1]] * 4]), "bench, topic /reference")


class DrawnPosor:
    """Scans and reference poses of a POSOR with parameters drawn from the uncertainties of its calibration."""

    def __init__(self, name: DesignName, count: int, seed: int, *, drawn: float = 1.0, turning: bool = False) -> None:
        """Draw the parameters (errors times ``drawn``) and the poses; ``turning``: theta increases from home on."""
        random = np.random.default_rng(seed)
        self.calibration = design(name)
        posor = Posor(self.calibration)
        self.unknowns = FreeParameters(self.calibration)
        self.truth = self.unknowns.start + drawn * self.unknowns.sigmas * random.normal(size=len(self.unknowns))
        stack = posor.stack.with_parameter_values(self.unknowns.parameter_vector(self.truth))
        rotations, translations = readable_poses(posor, name, count, random)
        if turning:  # from the home mark on, so that bumps can be counted
            natives = [native_from_rotation(rotation)[:2] for rotation in rotations]
            thetas = np.linspace(0.0, 0.01 * count, count)
            rotations = np.array([rotation_from_native(*lean, t) for lean, t in zip(natives, thetas, strict=True)])
        stamps = np.arange(1, count + 1, dtype=np.int64) * 10_000_000
        scans = scans_at(stack, rotations, translations, stamps, noise=random)
        scans = scans.with_fields({"at_home": STATED_HOME * (np.arange(count) == 0).astype(np.int64) * turning})
        complete = np.flatnonzero(readable(scans))
        self.scans = scans.select(complete)
        self.poses = [pin.SE3(rotations[i], translations[i]) for i in complete]
        self.measured = [
            pose * pin.exp6(np.concatenate([random.normal(size=3) * ALONG, random.normal(size=3) * ABOUT]))
            for pose in self.poses
        ]
        self.random = random

    def recording(self, poses: list[pin.SE3] | None = None, **changes: Any) -> Recording:
        """Return scans and reference; ``poses``: other reference poses, ``changes``: other fields of the recording."""
        tracks = {"/reference": pose_track(poses or self.measured, self.scans.stamps_ns)}
        return Recording(self.scans, **{"tracks": tracks, "source": "bench", **changes})

    def pulls(self, fit: Fit) -> FloatArray:
        """Return the error of each parameter of a fit over its standard uncertainty, (k,)."""
        where = {name: i for i, name in enumerate(self.unknowns.names)}
        shared = [(i, where[name]) for i, name in enumerate(fit.names) if name in where]
        return np.array([(fit.values[i] - self.truth[j]) / fit.sigmas[i] for i, j in shared])
