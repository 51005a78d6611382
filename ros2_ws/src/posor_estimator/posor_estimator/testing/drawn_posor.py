"""A simulated POSOR whose parameters were drawn from what its calibration says of them, with a pose reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from posor_estimator.accuracy.poses import readable, readable_poses
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.calibrate.unknowns import Unknowns
from posor_estimator.core.designs import design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import native_from_rotation, rotation_from_native
from posor_estimator.core.posor import Posor

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.designs import DesignName
    from posor_estimator.core.types import FloatArray, IntArray

ALONG, ABOUT = 2e-7, 2e-6
"""Standard uncertainty of the simulated reference [m, rad]."""


def pose_track(poses: list[pin.SE3], stamps: IntArray, sigmas: tuple[float, float] = (ALONG, ABOUT)) -> Track:
    """Return poses as a reference has them; ``sigmas`` along [m] and about [rad] every axis."""
    values = np.array([[*pose.translation, *pin.Quaternion(pose.rotation).coeffs()] for pose in poses])
    signs = np.where(np.sum(values[:, 3:] * values[0, 3:], axis=1) < 0.0, -1.0, 1.0)
    values[:, 3:] *= signs[:, None]
    return Track(stamps, values, np.array([*[sigmas[0]] * 3, *[0.5 * sigmas[1]] * 4]), "bench, topic /reference")


class DrawnPosor:
    """Scans of a POSOR whose parameters were drawn from what its calibration says of them."""

    def __init__(self, name: DesignName, count: int, seed: int, *, drawn: float = 1.0, turning: bool = False) -> None:
        """Draw the parameters (``drawn`` times their uncertainty) and the poses; ``turning`` from home on, steadily."""
        random = np.random.default_rng(seed)
        self.calibration = design(name)
        posor = Posor(self.calibration)
        self.unknowns = Unknowns(self.calibration)
        self.truth = self.unknowns.start + drawn * self.unknowns.sigmas * random.normal(size=len(self.unknowns))
        stack = posor.stack.with_parameter_values(self.unknowns.values(self.truth))
        rotations, translations = readable_poses(posor, name, count, random)
        if turning:  # from the home mark on, so that bumps can be counted
            natives = [native_from_rotation(rotation)[:2] for rotation in rotations]
            thetas = np.linspace(0.0, 0.01 * count, count)
            rotations = np.array([rotation_from_native(*lean, t) for lean, t in zip(natives, thetas, strict=True)])
        stamps = np.arange(1, count + 1, dtype=np.int64) * 10_000_000
        scans = scans_at(stack, rotations, translations, stamps, noise=random)
        scans = scans.with_fields({"at_home": (np.arange(count) == 0).astype(np.int64) * turning})
        kept = np.flatnonzero(readable(scans))
        self.scans = scans.chosen(kept)
        self.poses = [pin.SE3(rotations[i], translations[i]) for i in kept]
        self.measured = [
            pose * pin.exp6(np.concatenate([random.normal(size=3) * ALONG, random.normal(size=3) * ABOUT]))
            for pose in self.poses
        ]
        self.random = random

    def recording(self, poses: list[pin.SE3] | None = None, **changes: Any) -> Recording:
        """Return scans and reference (or other poses for it), with some fields of the recording changed."""
        tracks = {"/reference": pose_track(poses or self.measured, self.scans.stamps_ns)}
        return Recording(self.scans, **{"tracks": tracks, "source": "bench", **changes})

    def pulls(self, fit: Fit) -> FloatArray:
        """Return the error of each parameter of a fit over its standard uncertainty, (k,)."""
        where = {name: i for i, name in enumerate(self.unknowns.names)}
        shared = [(i, where[name]) for i, name in enumerate(fit.names) if name in where]
        return np.array([(fit.values[i] - self.truth[j]) / fit.sigmas[i] for i, j in shared])
