"""Orientation of the target plane: how the surface that the gap probes see leans against the axis of rotation.

While the target turns about an axis that keeps its direction, a plane that is not square to it makes the gaps change
with the sine and cosine of theta, which shows as a lean that is none. The two tilts of the plane are those with which
alpha and beta stay where the reference says; without a reference: where they were. Theta is the POSOR's own. Source:
thesis 8.3.1, where it is called the flatness of the plate and corrected by constants times sin(theta).

Of a direction of the axis that stands still nothing can be said: it is where alpha and beta have their zero. The range
of theta decides how well the two tilts are told from that zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.attitude_fit import AttitudeFit, Unknown, fit_attitude
from posor_estimator.core.calibrate.checks import check_enough
from posor_estimator.core.calibrate.fit import Loss
from posor_estimator.core.calibrate.orientation import Orientation, orientation_at
from posor_estimator.core.calibrate.parameters import indices, the_sensor
from posor_estimator.core.calibrate.procedure import Figure, Options, Outcome, Procedure
from posor_estimator.core.calibrate.recording import PROBES_ESTIMATED, SATURATED
from posor_estimator.core.calibrate.replacement import Replacement
from posor_estimator.core.calibrate.reporting import correlation_table, fit_warnings, parameter_table
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration

NAME = "target_plane"
ANGLES = ("alpha", "beta")
LEAST_SCANS = 6
URAD = 1e-6


class TargetPlaneOptions(Options):
    """Options of the target plane's orientation."""

    reference: str = Field(default="", description="topic of a reference of the lean; empty: the axis stands still")
    lever: float = Field(
        default=0.0, ge=0.0, description="distance of a reference point from the pivot [m]; 0: the reference is a pose"
    )
    wobble_sigma: float = Field(
        default=5e-6,
        gt=0.0,
        description="how still the axis keeps alpha and beta, or alpha beside a point, standard deviation [rad]",
    )
    session: str = Field(default="", description="session of the file whose zero shifts and maps hold")
    expected_tilt: float = Field(default=1e-3, gt=0.0, description="standard uncertainty of the tilts so far [rad]")
    longest_gap: float = Field(default=0.5, gt=0.0, description="references further apart are not joined by a line [s]")
    loss: Loss = Field(default="linear", description="of the fit; soft_l1 or huber survive outliers")
    trust_sigmas: bool = Field(
        default=True, description="whether readings scatter as stated; if not, the uncertainty follows the residuals"
    )


def find_target_plane(recording: Recording, calibration: Calibration, options: TargetPlaneOptions) -> Outcome:
    """Find the tilts of the target plane; see ``TargetPlaneOptions``.

    Raises:
        FitError: The data do not determine the tilts.
        TrackError: The reference does not serve.
        CalibrationError: There is no such session.

    """
    applied = calibration.for_session(options.session)
    sensor, part = the_sensor(applied, GapProbesCalibration, NAME)
    sound = ~recording.having(PROBES_ESTIMATED | SATURATED)
    check_enough(int(sound.sum()), LEAST_SCANS, "scans", f"{NAME}, {recording.source}")
    where = indices(applied, sensor, ["plane_tilt[0]", "plane_tilt[1]"])
    found = fit_attitude(
        calibration,
        options.session,
        recording.scans,
        sound,
        _reference(recording, options),
        [Unknown(f"tilt about {axis}", "rad", int(where[i]), options.expected_tilt) for i, axis in enumerate("XY")],
        ANGLES,
        first_sigma=None,
        check=False,  # a wrong tilt feigns just such a motion
        along=False,  # no more than noise moves, and a scale of the readings found from that would be wrong
        loss=options.loss,
        trust_sigmas=options.trust_sigmas,
        what=NAME,
    )
    fit = found.fit
    scales = np.array([options.expected_tilt] * 2 + [1e-3] * (len(fit.names) - 2))
    key = f"sensors[{sensor}].target_plane.tilt"
    return Outcome(
        method=f"least squares of alpha and beta over a turn of {_turn(found):.3g} rad of an axis that "
        f"{'is measured' if options.reference or options.lever else 'keeps its direction'} (thesis 8.3.1)",
        fits={NAME: fit},
        replacements=(Replacement(key, fit.values[:2].tolist(), fit.sigmas[:2].tolist()),),
        covariances=(found.taken.joint((f"{key}[0]", f"{key}[1]"), fit),),
        tables=(
            parameter_table("tilt of the target plane", fit, part.target_plane.tilt.array, 2),
            correlation_table(fit, len(fit.names)),
        ),
        warnings=fit_warnings(fit, scales, 2, found.readings),
        figures=_figures(found),
    )


def _reference(recording: Recording, options: TargetPlaneOptions) -> Orientation:
    stamps = recording.scans.stamps_ns
    if options.reference or options.lever:
        return orientation_at(
            recording,
            stamps,
            options.reference,
            lever=options.lever,
            twist_sigma=options.wobble_sigma,
            longest_gap_s=options.longest_gap,
        )
    return Orientation(np.zeros((len(stamps), 3)), np.array([options.wobble_sigma] * 2 + [np.inf]))


def _turn(found: AttitudeFit) -> float:
    """Return how far theta went [rad]."""
    return float(np.ptp(found.thetas[found.used]))


def _figures(found: AttitudeFit) -> tuple[Figure, ...]:
    thetas = found.thetas[found.used]
    return tuple(
        Figure(
            f"{angle} that is none",
            "theta [rad]",
            f"{angle}, POSOR less reference [urad]",
            {
                name: (thetas, errors[found.used, i] / URAD)
                for name, errors in (("before", found.before), ("after", found.after))
            },
        )
        for i, angle in enumerate(ANGLES)
    )


PROCEDURE = Procedure(
    NAME, "tilt of the target plane against the axis of rotation, from a turn", TargetPlaneOptions, find_target_plane
)
