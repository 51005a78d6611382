from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.calibrate.probe_spacing import ProbeSpacingOptions, run
from posor_estimator.errors import FitError, TrackError
from posor_estimator.testing.campaign import exact, posor, tilted, with_tips
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest, chi2

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.types import FloatArray

TIPS = np.array([[-0.07635, 0.0, 0.0], [0.0, 0.03802, 0.0], [0.0, -0.03814, 0.0]])
TRUE = np.array([-0.07635, 0.03802, -0.03814])
GRID = np.linspace(-5e-3, 5e-3, 4)
ANGLES = np.array([(about_x, about_y) for about_x in GRID for about_y in GRID])


def taken(seed: int = 0, angles: FloatArray = ANGLES, sigma: float = 3e-6) -> Recording:
    return tilted(with_tips(posor(), TIPS), angles, np.random.default_rng(seed), scans_each=12, sigma=sigma)


def found(taken: Recording, **options: Any) -> Outcome:
    return run(taken, exact(posor()), ProbeSpacingOptions(**options))


def turned(before: Recording, turn: Any) -> Recording:
    track = before.tracks["/reference"]
    values = track.values.copy()
    values[:, 3:] = turn(Rotation.from_quat(values[:, 3:])).as_quat()
    return replace(before, tracks={"/reference": replace(track, values=values)})


def test_truth_lies_in_the_95_percent_intervals_of_95_percent_of_campaigns() -> None:
    inside, squares, freedoms = 0, 0.0, 0
    for seed in range(25):
        fit = found(taken(seed)).fits["probe_spacing"]
        inside += int(np.sum(np.abs(fit.values[:3] - TRUE) < 1.96 * fit.sigmas[:3]))
        squares, freedoms = squares + fit.spread**2 * fit.freedoms, freedoms + fit.freedoms
    assert binomtest(inside, 75, 0.95).pvalue > 0.01
    assert 0.005 < chi2.sf(squares, freedoms) < 0.995


def test_free_height_takes_a_residual_of_each_stop_and_a_measured_one_is_a_reading() -> None:
    free, measured = (found(taken(), **options).fits["probe_spacing"] for options in ({}, {"lift_sigma": 2e-5}))
    stops, unknowns = len(ANGLES), 5  # three spacings, and the zeros of two probes against that of the first
    assert (free.freedoms, len(free.residuals)) == (2 * stops - unknowns, 2 * stops)
    assert (measured.freedoms, len(measured.residuals)) == (3 * stops - unknowns, 3 * stops)
    for fit in (free, measured):  # the heights scatter by 20 um
        assert 0.005 < fit.probability < 0.995
        assert np.all(np.abs(fit.values[:3] - TRUE) < 4.0 * fit.sigmas[:3])


def test_only_the_fitted_coordinates_of_the_tips_change() -> None:
    outcome = run(taken(), posor(), ProbeSpacingOptions())
    new = {one.key: one for one in outcome.replacements}
    assert list(new) == [f"sensors[0].probes[{probe}].tip" for probe in range(3)]
    for probe, (value, truth) in enumerate(zip(new.values(), TIPS, strict=True)):
        axis = int(np.argmax(np.abs(truth)))
        sigmas: Any = value.sigma
        assert abs(np.array(value.value)[axis] - TRUE[probe]) < 4.0 * sigmas[axis] < 2e-4
        assert [sigma for a, sigma in enumerate(sigmas) if a != axis] == [20e-6, 1e-6]
    # What was taken for known, such as how far the probes sit off their axes, varies with it and stands behind it.
    assert outcome.covariances[0].entries[:3] == (
        "sensors[0].probes[0].tip[0]",
        "sensors[0].probes[1].tip[1]",
        "sensors[0].probes[2].tip[1]",
    )
    assert "sensors[0].probes[1].tip[0]" in outcome.covariances[0].entries
    assert np.all(outcome.fits["probe_spacing"].sigmas[:3] > 1.5 * found(taken()).fits["probe_spacing"].sigmas[:3])


def test_scale_of_the_angles_counts_for_all_spacings_alike() -> None:
    joint = found(taken(), scale_sigma=1e-2).covariances[0].matrix
    np.testing.assert_allclose(np.sqrt(np.diag(joint)), 1e-2 * np.abs(TRUE), rtol=2e-2)


def test_angles_about_one_axis_do_not_tell_all_spacings() -> None:
    about_x = np.column_stack([np.linspace(-5e-3, 5e-3, 9), np.zeros(9)])
    with pytest.raises(FitError, match=r"^probe_spacing: the angles hardly tell gap_1.x, its standard"):
        found(taken(angles=about_x, sigma=0.0))
    fit = found(taken(angles=about_x), coordinates=("gap_2.y", "gap_3.y")).fits["probe_spacing"]
    assert np.all(np.abs(fit.values[:2] - TRUE[1:]) < 4.0 * fit.sigmas[:2])


def test_coordinate_that_is_none_is_refused() -> None:
    with pytest.raises(FitError) as caught:
        found(taken(), coordinates=("gap_4.x",))
    assert str(caught.value) == (
        "probe_spacing: coordinate 'gap_4.x'; expected one of gap_1, gap_2, gap_3 with .x or .y after it."
    )


def test_swapped_axes_are_named() -> None:
    swapped = turned(taken(), lambda turns: Rotation.from_rotvec(turns.as_rotvec()[:, [1, 0, 2]]))
    with pytest.raises(TrackError, match="the readings fit the angles with X and Y exchanged; the axes look swapped"):
        found(swapped)


@pytest.mark.parametrize(("factor", "times"), [(-1.0, "-1"), (1.0 / 25.4, r"25\.\d"), (np.pi / 180.0, r"57\.\d")])
def test_angles_of_the_wrong_size_or_sign_are_named(factor: float, times: str) -> None:
    wrong = turned(taken(sigma=0.0), lambda turns: Rotation.from_rotvec(factor * turns.as_rotvec()))
    with pytest.raises(FitError, match=f"the spacing comes out {times} times as large as it is calibrated"):
        found(wrong, still=1e-6)


def test_stop_that_does_not_fit_is_named_and_survived() -> None:
    before = taken()
    volts = before.scans.gap_voltages.copy()
    volts[17 * 6 : 17 * 6 + 12, 1] += 0.2
    outcome = found(replace(before, scans=before.scans.with_fields({"gap_voltages": volts})))
    assert outcome.warnings[0] == "probe_spacing: left out stop 7, which do not fit the others."
    fit = outcome.fits["probe_spacing"]
    assert np.all(np.abs(fit.values[:3] - TRUE) < 4.0 * fit.sigmas[:3])


def test_stuck_channel_and_too_few_stops_are_refused() -> None:
    before = taken()
    volts = before.scans.gap_voltages.copy()
    volts[:, 2] = -1.5
    with pytest.raises(FitError, match=r"^simulated: gap probe gap_3 stays at -1\.5 while the reference moves"):
        found(replace(before, scans=before.scans.with_fields({"gap_voltages": volts})))
    with pytest.raises(FitError, match=r"^probe_spacing: 4 stops of the reference with scans; expected at least 5\.$"):
        found(taken(angles=ANGLES[::4]))
