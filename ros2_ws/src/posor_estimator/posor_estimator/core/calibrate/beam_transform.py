"""From one POSOR to the next: the measuring beam's transform, as in hand-eye calibration.

A beam carries the target plate of one POSOR at one end and the receiving plate of the next at the other. With both
POSORs moving and a reference that watches what the second one carries,

    T_world_seen = T_base T_receiving1_target1 T_beam T_receiving2_target2 T_end

the middle one is the beam's; base and end say how the reference sits. All three are fitted together through the poses
that the POSORs measure, what was known of them before counting as a reading each. A POSOR that only turns about its own
axis does not tell whether a shift along that axis, or a turn about it, belongs to what is before or behind it: such
combinations stay as they were, and are said. So what is known well of base and end has to be told. Source of the
problem: thesis 9.3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field

from posor_estimator.core.calibrate.checks import check_axis, check_enough, check_spread, check_unit
from posor_estimator.core.calibrate.fit import Loss, fit
from posor_estimator.core.calibrate.procedure import Options, Outcome, Procedure, Table
from posor_estimator.core.calibrate.recording import POSE, PROBES_ESTIMATED, SATURATED, poses_of
from posor_estimator.core.calibrate.reporting import correlation_table, fit_warnings, parameter_table
from posor_estimator.core.posor import Posor
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import BoolArray, FloatArray

NAME = "beam_transform"
LEAST_POSES = 6
CLEAR_MOTION, CLEAR = 1e-3, 50.0
"""Motion along an axis [m], and over the reference's uncertainty, from which it is compared with the chain's."""
SIX = ("x", "y", "z", "about x", "about y", "about z")
Sigma = Annotated[float, Field(gt=0.0)]
NO_TURN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class BeamTransformOptions(Options):
    """Options of the beam's transform; a transform is x, y, z [m], roll, pitch, yaw [rad], as in a URDF."""

    second: str = Field(description="topic of the second POSOR's pose, a geometry_msgs/TransformStamped")
    reference: str = Field(description="topic of the reference, the pose of what the second POSOR carries")
    beam: tuple[float, float, float, float, float, float] = Field(
        description="the beam as drawn, from the first POSOR's target plate to the second's receiving plate"
    )
    base: tuple[float, float, float, float, float, float] = Field(
        default=NO_TURN, description="from the reference's own frame to the first POSOR's receiving plate"
    )
    end: tuple[float, float, float, float, float, float] = Field(
        default=NO_TURN, description="from the second POSOR's target plate to what the reference sees"
    )
    beam_known: tuple[Sigma, Sigma] = Field(
        default=(1e-3, 5e-3), description="standard uncertainty of the beam's place [m] and orientation [rad] before"
    )
    base_known: tuple[Sigma, Sigma] = Field(default=(1e-3, 5e-3), description="the same of the base")
    end_known: tuple[Sigma, Sigma] = Field(default=(1e-3, 5e-3), description="the same of the end")
    session: str = Field(default="", description="session of the file that holds")
    longest_gap: float = Field(default=0.5, gt=0.0, description="references further apart are not joined by a line [s]")
    loss: Loss = Field(default="linear", description="of the fit; soft_l1 or huber survive outliers")


def transform(six: tuple[float, ...]) -> pin.SE3:
    """Return the transform of x, y, z [m], roll, pitch, yaw [rad]."""
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(six[3:])), np.array(six[:3]))


class _Chain:
    """Poses of both POSORs and of the reference, and what the unknown transforms make of them."""

    def __init__(self, recording: Recording, calibration: Calibration, options: BeamTransformOptions) -> None:
        recording = recording.without(PROBES_ESTIMATED | SATURATED)
        scans = recording.scans
        gap = round(options.longest_gap * 1e9)
        second, reference = (recording.track(topic, POSE) for topic in (options.second, options.reference))
        found = Posor(calibration.for_session(options.session)).locate_all(scans)
        values = [track.at(scans.stamps_ns, gap) for track in (second, reference)]
        self.used: BoolArray = np.asarray(np.isfinite(np.column_stack([found.translations, *values])).all(axis=1))
        check_enough(int(self.used.sum()), LEAST_POSES, "poses that both POSORs and the reference know", NAME)
        self._numbers = scans.numbers[self.used]
        self._first = _poses(found.rotations[self.used], found.translations[self.used])
        self._second, self._reference = (_poses(*poses_of(value[self.used])) for value in values)
        self.nominal = [transform(six) for six in (options.base, options.beam, options.end)]
        own = np.array(
            [
                turn.T @ covariance @ turn
                for turn, covariance in (
                    (np.kron(np.eye(2), pose.rotation), covariance)
                    for pose, covariance in zip(self._first, found.covariances_random[self.used], strict=True)
                )
            ]
        )
        self._check_reference(reference.source, reference.sigmas[:3])
        self._whiten = self._whitening(own, _tangent(second.sigmas), _tangent(reference.sigmas))

    def _check_reference(self, source: str, sigmas: FloatArray) -> None:
        """Refuse a reference that moves along other axes, or by another factor, than the chain as drawn."""
        base, beam, end = self.nominal
        chains = [base * a * beam * b * end for a, b in zip(self._first, self._second, strict=True)]
        drawn, seen = (np.array([pose.translation for pose in poses]) for poses in (chains, self._reference))
        for axis, name in enumerate(SIX[:3]):
            if np.ptp(drawn[:, axis]) > max(CLEAR_MOTION, CLEAR * float(sigmas[axis])):
                check_axis(drawn[:, axis], seen, axis, SIX[:3], source)
                check_unit(drawn[:, axis], seen[:, axis], f"{source}, {name}", "m")

    def _whitening(self, first: FloatArray, second: FloatArray, reference: FloatArray) -> FloatArray:
        """Return what makes the misfits (n, 6) independent, of variance 1, (n, 6, 6)."""
        out = []
        for covariance, pose in zip(first, self._second, strict=True):
            after = (self.nominal[1] * pose * self.nominal[2]).inverse().toActionMatrix()
            end = self.nominal[2].inverse().toActionMatrix()
            whole = after @ covariance @ after.T + end @ np.diag(second**2) @ end.T + np.diag(reference**2)
            out.append(np.linalg.inv(np.linalg.cholesky(whole)))
        return np.array(out)

    def transforms(self, unknowns: FloatArray) -> list[pin.SE3]:
        """Return base, beam and end for their corrections (18,), each in the local tangent."""
        return [nominal * pin.exp6(part) for nominal, part in zip(self.nominal, unknowns.reshape(3, 6), strict=True)]

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Return the misfits over their standard uncertainty, (6 n,)."""
        base, beam, end = self.transforms(unknowns)
        off = np.array(
            [
                pin.log6((base * first * beam * second * end).actInv(seen)).vector
                for first, second, seen in zip(self._first, self._second, self._reference, strict=True)
            ]
        )
        return np.asarray(np.einsum("nij,nj->ni", self._whiten, off).ravel())

    def names(self) -> list[str]:
        """Return what to call each residual."""
        return [f"{axis} of scan {number}" for number in self._numbers for axis in SIX]


def _poses(rotations: FloatArray, translations: FloatArray) -> list[pin.SE3]:
    return [pin.SE3(r, t) for r, t in zip(rotations, translations, strict=True)]


def _tangent(sigmas: FloatArray) -> FloatArray:
    """Return the standard uncertainty along and about three axes (6,) of a pose track's (7,)."""
    # A small turn changes the components of the quaternion by half its angle; places are taken as good along any axis.
    return np.repeat([np.sqrt(np.mean(np.square(part))) for part in (sigmas[:3], 2.0 * sigmas[3:])], 3)


def find_beam_transform(recording: Recording, calibration: Calibration, options: BeamTransformOptions) -> Outcome:
    """Find the transform between two POSORs of a beam; see ``BeamTransformOptions``.

    Raises:
        FitError: The poses do not suffice, or the reference has no uncertainty.
        TrackError: A reference does not serve.
        CalibrationError: There is no such session.

    """
    exact = [topic for topic in (options.second, options.reference) if not recording.track(topic, POSE).sigmas.any()]
    if len(exact) == 2:  # noqa: PLR2004
        raise FitError(
            f"no uncertainty is known of {' and '.join(exact)}", where=NAME, expected="that of the instruments"
        )
    chain = _Chain(recording, calibration, options)
    scales = np.repeat([*options.base_known, *options.beam_known, *options.end_known], 3)
    found = fit(
        chain.residuals,
        np.zeros(18),
        [f"{what} {axis}" for what in ("base", "beam", "end") for axis in SIX],
        [*["m"] * 3, *["rad"] * 3] * 3,
        scales,
        prior=True,
        loss=options.loss,
        what=NAME,
    )
    check_spread(found, chain.names(), NAME)
    return Outcome(
        method=f"hand-eye fit of base, beam and end to {int(chain.used.sum())} poses of two POSORs and a reference",
        fits={NAME: found},
        tables=(
            _urdf_table(chain, found),
            parameter_table("corrections, in the axes of each transform's end", found, np.zeros(18), 18),
            correlation_table(found, 18),
        ),
        warnings=fit_warnings(found, scales, 0, chain.names()),
    )


def _urdf_table(chain: _Chain, found: Fit) -> Table:
    rows = []
    for index, (name, made) in enumerate(zip(("base", "beam", "end"), chain.transforms(found.values), strict=True)):
        turn = np.kron(np.eye(2), made.rotation)
        covariance = found.covariance[6 * index : 6 * index + 6, 6 * index : 6 * index + 6]
        sigmas = np.sqrt(np.diag(turn @ covariance @ turn.T))
        six = np.concatenate([made.translation, pin.rpy.matrixToRpy(made.rotation)])
        labels = ("x", "y", "z", "roll; sigma about X", "pitch; sigma about Y", "yaw; sigma about Z")
        rows += [
            (f"{name} {label}", float(value), float(sigma), "m" if i < 3 else "rad")  # noqa: PLR2004
            for i, (label, value, sigma) in enumerate(zip(labels, six, sigmas, strict=True))
        ]
    columns = ("as in a URDF, axes of the parent", "found", "sigma", "unit")
    return Table("transforms", columns, ("",) * 4, tuple(rows))


PROCEDURE = Procedure(
    NAME,
    "transform of a beam from one POSOR to the next, from both and a reference",
    BeamTransformOptions,
    find_beam_transform,
)
