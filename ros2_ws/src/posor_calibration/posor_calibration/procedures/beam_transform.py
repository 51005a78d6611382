# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Transform of a measuring beam between two POSORs, as in hand-eye calibration.

A beam carries the target plate of one POSOR at one end and the receiving plate of the next at the other. With both
POSORs moving and a reference that watches the load of the second POSOR,

    T_world_seen = T_base T_receiving1_target1 T_beam T_receiving2_target2 T_end

where base and end describe the mounting of the reference. All three are fitted together to the poses of the POSORs,
with prior knowledge as readings. A POSOR that only turns about its own axis does not tell whether a shift along that
axis, or a rotation about it, belongs before or behind it: such combinations stay as they were, and are reported. Source
of the problem: thesis 9.3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import pinocchio as pin
from posor.bags.recording import POSE, unpack_poses
from posor.errors import FitError
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES
from posor.model.scan import PROBES_ESTIMATED, SATURATED
from pydantic import Field

from posor_calibration.data_checks import POSE_AXES, check_axis, check_count, check_unit
from posor_calibration.dwells import use_values_once
from posor_calibration.fit_report import check_spread, describe_fit, result_tables
from posor_calibration.least_squares import fit_parameters
from posor_calibration.procedure import LongestGapOption, LossOption, Options, Outcome, Procedure, SessionOption, Table
from posor_calibration.recorded_poses import count_from_first_mark, counted_estimates

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_calibration.least_squares import Fit

NAME = "beam_transform"
MIN_POSES = 6
CLEAR_MOTION, CLEAR_SIGMAS = 1e-3, 50.0
"""Motion along an axis [m], and over the reference's uncertainty, above which it is compared with the chain's."""
PARTS = ("base", "beam", "end")
Transform = tuple[float, float, float, float, float, float]
Sigma = Annotated[float, Field(gt=0.0)]
IDENTITY: Transform = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class BeamTransformOptions(Options):
    """Options of ``beam_transform``; a transform is x, y, z [m], roll, pitch, yaw [rad], as in a URDF."""

    second: str = Field(description="topic of the second POSOR's pose, a geometry_msgs/TransformStamped")
    reference: str = Field(description="topic of the reference, the pose of what the second POSOR carries")
    beam: Transform = Field(
        description="the beam as drawn, from the first POSOR's target plate to the second's receiving plate"
    )
    base: Transform = Field(
        default=IDENTITY, description="from the reference's own frame to the first POSOR's receiving plate"
    )
    end: Transform = Field(
        default=IDENTITY, description="from the second POSOR's target plate to what the reference sees"
    )
    beam_known: tuple[Sigma, Sigma] = Field(
        default=(1e-3, 5e-3), description="prior standard uncertainty of the beam's position [m] and orientation [rad]"
    )
    base_known: tuple[Sigma, Sigma] = Field(default=(1e-3, 5e-3), description="the same of the base")
    end_known: tuple[Sigma, Sigma] = Field(default=(1e-3, 5e-3), description="the same of the end")
    session: SessionOption = ""
    longest_gap: LongestGapOption = 0.5
    loss: LossOption = "linear"


def make_transform(values: Transform) -> pin.SE3:
    """Return the transform of x, y, z [m], roll, pitch, yaw [rad]."""
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(values[3:])), np.array(values[:3]))


class _Chain:
    """Poses of both POSORs and of the reference, and residuals of the unknown transforms."""

    def __init__(self, recording: Recording, calibration: Calibration, options: BeamTransformOptions) -> None:
        scans = recording.without_status(PROBES_ESTIMATED | SATURATED).scans
        gap_ns = round(options.longest_gap * 1e9)
        second, reference = (recording.find_track(topic, POSE) for topic in (options.second, options.reference))
        posor, where = Posor(calibration.for_session(options.session)), f"{NAME}, {recording.source}"
        estimates = counted_estimates(posor, count_from_first_mark(posor, scans, where), where)
        values = [track.interpolate(scans.stamps_ns, gap_ns) for track in (second, reference)]
        known: BoolArray = np.asarray(np.isfinite(np.column_stack(values)).all(axis=1))
        used: BoolArray = known & np.isin(estimates.states, USABLE_STATES)
        for track in (second, reference):
            used = use_values_once(track, scans.stamps_ns, used)
        self.count = int(used.sum())
        check_count(self.count, MIN_POSES, "poses with a counted theta that both POSORs and the reference know", NAME)
        self.names = [f"{axis} of scan {number}" for number in scans.numbers[used] for axis in POSE_AXES]
        self._first = _make_poses(estimates.rotations[used], estimates.translations[used])
        self._second, self._reference = (_make_poses(*unpack_poses(value[used])) for value in values)
        self.nominal = [make_transform(values) for values in (options.base, options.beam, options.end)]
        self._check_reference(reference.source, reference.sigmas[:3])
        self._whiten = self._make_whitening(
            estimates.covariances_random[used], _tangent_sigmas(second.sigmas), _tangent_sigmas(reference.sigmas)
        )

    def _check_reference(self, source: str, sigmas: FloatArray) -> None:
        """Refuse a reference that moves along other axes, or by another factor, than the chain as drawn."""
        base, beam, end = self.nominal
        chains = [base * a * beam * b * end for a, b in zip(self._first, self._second, strict=True)]
        drawn, seen = (np.array([pose.translation for pose in poses]) for poses in (chains, self._reference))
        for axis, name in enumerate(POSE_AXES[:3]):
            if np.ptp(drawn[:, axis]) > max(CLEAR_MOTION, CLEAR_SIGMAS * float(sigmas[axis])):
                check_axis(drawn[:, axis], seen, axis, POSE_AXES[:3], source)
                check_unit(drawn[:, axis], seen[:, axis], f"{source}, {name}", "m")

    def _make_whitening(self, covariances: FloatArray, second: FloatArray, reference: FloatArray) -> FloatArray:
        """Return the matrices that make the misfits (n, 6) independent, of variance 1, (n, 6, 6)."""
        out = []
        end = self.nominal[2].inverse().toActionMatrix()
        for covariance, first, pose in zip(covariances, self._first, self._second, strict=True):
            turn = np.kron(np.eye(2), first.rotation)
            local = turn.T @ covariance @ turn
            after = (self.nominal[1] * pose * self.nominal[2]).inverse().toActionMatrix()
            whole = after @ local @ after.T + end @ np.diag(second**2) @ end.T + np.diag(reference**2)
            out.append(np.linalg.inv(np.linalg.cholesky(whole)))
        return np.array(out)

    def transforms(self, unknowns: FloatArray) -> list[pin.SE3]:
        """Return base, beam and end for their corrections (18,), each in the local tangent."""
        return [nominal * pin.exp6(part) for nominal, part in zip(self.nominal, unknowns.reshape(3, 6), strict=True)]

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Return the misfits over their standard uncertainty, (6 n,)."""
        base, beam, end = self.transforms(unknowns)
        poses = zip(self._first, self._second, self._reference, strict=True)
        misfits = np.array([pin.log6((base * a * beam * b * end).actInv(seen)).vector for a, b, seen in poses])
        return np.asarray(np.einsum("nij,nj->ni", self._whiten, misfits).ravel())


def _make_poses(rotations: FloatArray, translations: FloatArray) -> list[pin.SE3]:
    return [pin.SE3(r, t) for r, t in zip(rotations, translations, strict=True)]


def _tangent_sigmas(sigmas: FloatArray) -> FloatArray:
    """Return the standard uncertainty along and about three axes (6,), alike for all, of a pose track's (7,)."""
    # A small rotation changes the components of the quaternion by half its angle.
    return np.repeat([np.sqrt(np.mean(np.square(part))) for part in (sigmas[:3], 2.0 * sigmas[3:])], 3)


def find_beam_transform(recording: Recording, calibration: Calibration, options: BeamTransformOptions) -> Outcome:
    """Find the transform of a beam between two POSORs; raises as ``Procedure.identify``."""
    topics = (options.second, options.reference)
    if not any(recording.find_track(topic, POSE).sigmas.any() for topic in topics):
        what = f"no uncertainty is known of {' and '.join(topics)}"
        raise FitError(what, where=NAME, expected="that of the instruments")
    chain = _Chain(recording, calibration, options)
    scales = np.repeat([*options.base_known, *options.beam_known, *options.end_known], 3)
    found = fit_parameters(
        chain.residuals,
        np.zeros(18),
        [f"{part} {axis}" for part in PARTS for axis in POSE_AXES],
        [*["m"] * 3, *["rad"] * 3] * 3,
        scales,
        prior=True,
        loss=options.loss,
        what=NAME,
    )
    check_spread(found, chain.names, NAME)
    return Outcome(
        method=f"hand-eye fit of base, beam and end to {chain.count} poses of two POSORs and a reference",
        fits={NAME: found},
        tables=(
            _tabulate_transforms(chain, found),
            *result_tables("corrections, in the axes of each transform's end", found, np.zeros(18), 18),
        ),
        warnings=describe_fit(found, scales, 0, chain.names),
    )


def _tabulate_transforms(chain: _Chain, found: Fit) -> Table:
    labels = ("x", "y", "z", "roll; sigma about X", "pitch; sigma about Y", "yaw; sigma about Z")
    units = ("m",) * 3 + ("rad",) * 3
    rows = []
    for index, (part, transform) in enumerate(zip(PARTS, chain.transforms(found.values), strict=True)):
        turn, own = np.kron(np.eye(2), transform.rotation), slice(6 * index, 6 * index + 6)
        sigmas = np.sqrt(np.diag(turn @ found.covariance[own, own] @ turn.T))
        values = np.concatenate([transform.translation, pin.rpy.matrixToRpy(transform.rotation)])
        rows += [
            (f"{part} {label}", float(value), float(sigma), unit)
            for label, value, sigma, unit in zip(labels, values, sigmas, units, strict=True)
        ]
    return Table("transforms", ("as in a URDF, axes of the parent", "found", "sigma", "unit"), ("",) * 4, tuple(rows))


PROCEDURE = Procedure(
    NAME,
    "transform of a beam from one POSOR to the next, from both and a reference",
    BeamTransformOptions,
    find_beam_transform,
    drift_of=(),
)
