"""Simulated calibration campaigns: what is drawn, what is recorded, and how it is judged."""

from __future__ import annotations

import multiprocessing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.polynomial import chebyshev
from posor_bringup.arm_coverage import Figure
from posor_bringup.campaign import bagged, campaign
from posor_bringup.campaign.bagged import Bagged, calibrate_bags, make_bags
from posor_bringup.campaign.campaign import run_campaign
from posor_bringup.campaign.determined import determined
from posor_bringup.campaign.judged import Judged, family_of, judged
from posor_bringup.campaign.many import FRESH, One, coverage_of, interval_of, many_campaigns
from posor_bringup.campaign.plant import DRIFT, Plant, as_built
from posor_bringup.campaign.steps import INTERFEROMETER, steps_of
from posor_bringup.campaign.told import Told, findings_of_many
from posor_bringup.findings import Verdict
from posor_estimator.core.calibration.entries import entries_of
from posor_estimator.core.calibration.model import calibration_from
from scipy.stats import binomtest

if TYPE_CHECKING:
    from pathlib import Path

    from posor_bringup.campaign.steps import Step
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration

SEED = 7


def test_a_posor_differs_from_what_is_known_of_it_by_as_much_as_is_stated() -> None:
    known = as_built("triad_bumpy_ring")
    told = [e for e in entries_of(known) if e is not None and e.quantity.sigmas[e.index] > 0.0 and "axis" not in e.name]
    drawn = [Plant.drawn("triad_bumpy_ring", seed).truth() for seed in range(25)]
    off = np.array(
        [
            [(truth[e.name] - float(e.quantity.array[e.index])) / float(e.quantity.sigmas[e.index]) for e in told]
            for truth in drawn
        ]
    )
    assert off.shape[1] > 50
    assert np.mean(np.square(off)) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / off.size))
    assert np.mean(off) == pytest.approx(0.0, abs=5.0 / np.sqrt(off.size))
    shifts = np.array([[truth[f"sensors[0].probes[{k}].zero_shift"] for k in range(3)] for truth in drawn])
    assert np.sqrt(np.mean(np.square(shifts))) == pytest.approx(DRIFT, rel=5.0 / np.sqrt(2.0 * shifts.size))


def test_a_posor_is_the_same_for_the_same_seed_only() -> None:
    assert Plant.drawn("triad_diodes", SEED).truth() == Plant.drawn("triad_diodes", SEED).truth()
    assert Plant.drawn("triad_diodes", SEED).truth() != Plant.drawn("triad_diodes", SEED + 1).truth()


def test_a_step_records_the_same_for_the_same_seed_and_its_reference_is_off_as_stated() -> None:
    first = steps_of("triad_diodes")[0]
    plant = Plant.drawn("triad_diodes", SEED)
    one, same = first.record(plant), first.record(plant)
    assert np.array_equal(one.scans.gap_voltages, same.scans.gap_voltages)
    track = one.tracks["/reference"]
    assert track.sigmas.tolist() == [INTERFEROMETER]
    places, counts = np.unique(track.values, return_counts=True)
    stops = places[counts > 1]
    assert len(stops) == 25
    off = np.sort(stops) - np.linspace(0.17e-3, 1.34e-3, 25)
    assert 0.5 * INTERFEROMETER < np.std(off) < 1.6 * INTERFEROMETER


def test_bags_through_the_command_line_give_what_recordings_in_memory_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = steps_of("triad_diodes")[:4]
    monkeypatch.setattr(bagged, "steps_of", lambda _: chosen)
    plant = Plant.drawn("triad_diodes", SEED)
    made: list[str] = []
    bags = make_bags(plant, tmp_path / "bags", lambda: made.append("bag"))
    done = calibrate_bags(plant, bags, tmp_path, lambda: made.append("step"))
    assert made == ["bag"] * 4 + ["step"] * 4
    in_memory = [one for one, _ in zip(run_campaign(plant), chosen, strict=False)]
    for one, other in zip(done, in_memory, strict=True):
        assert one.step.name == other.step.name
        numbers, expected = judged(plant, one.calibration), judged(plant, other.calibration)
        assert [n.name for n in numbers] == [n.name for n in expected]
        assert np.allclose([n.estimate for n in numbers], [n.estimate for n in expected], rtol=1e-9, atol=1e-15)
        assert np.allclose([n.sigma for n in numbers], [n.sigma for n in expected], rtol=1e-6)
        assert (tmp_path / f"{one.step.name}.txt").read_text(encoding="utf-8").strip()
    record = done[0].calibration.fits[0]
    assert record.method == "polynomials through 25 stops, order 4 as asked (thesis 7.5.1)"
    assert record.instruments[0].name == "interferometer"
    assert record.instruments[0].sigmas == [INTERFEROMETER]
    assert len(record.recording.sha256) == 64
    assert record.recording.name == "1_gaps"
    check_maps(plant, done[-1].calibration)


def check_maps(plant: Plant, calibration: Any) -> None:
    """Compare the true coefficients of the first map, in its own terms, with the surface of the sensor itself."""
    truth = {n.name: n.truth for n in judged(plant, calibration) if ".maps." in n.name}
    known: Any = plant.known.sensors[1]
    sensor: Any = plant.first_day.sensors[1]
    names, values = list(sensor.parameter_names), sensor.parameter_values
    old, new = known.maps[known.map][0], calibration.sensors[1].maps[calibration.sensors[1].map][0]
    size = len(old.x.array)
    first = names.index("maps[0,0]")
    coefficients = values[first : first + size**2].reshape(size, size)
    found = np.array(
        [
            [truth.get(f"sensors[1].maps.{calibration.sensors[1].map}[0].x[{i}][{j}]", 0.0) for j in range(size)]
            for i in range(size)
        ]
    )
    assert np.count_nonzero(found) == 10
    for ratios in ((-0.3, 0.2), (0.1, 0.4), (0.35, -0.35)):
        at: list[float] = [(r - d.mean()) / (0.5 * np.ptp(d)) for r, d in zip(ratios, old.domain.array, strict=True)]
        there: list[float] = [(r - d.mean()) / (0.5 * np.ptp(d)) for r, d in zip(ratios, new.domain.array, strict=True)]
        surface, expected = (float(chebyshev.chebval2d(x, y, c)) for (x, y), c in ((there, found), (at, coefficients)))
        assert surface == pytest.approx(expected, abs=1e-9)


def less_told(step: Step) -> Step:
    """Return a step whose instrument is three times as noisy as the procedure is told."""

    def record(plant: Plant) -> Recording:
        made = step.record(plant)
        return replace(made, tracks={key: replace(t, sigmas=t.sigmas / 3.0) for key, t in made.tracks.items()})

    return replace(step, record=record)


@pytest.mark.timeout(300)
def test_an_instrument_noisier_than_told_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    *steps, bundle = steps_of("triad_diodes")
    plant = Plant.drawn("triad_diodes", SEED)
    verdicts_of = {}
    monkeypatch.setattr(campaign, "steps_of", lambda _: (*steps, bundle))
    done = list(run_campaign(plant))
    verdicts_of["right"] = told_of(plant, done)
    monkeypatch.setattr(campaign, "steps_of", lambda _: (less_told(bundle),))
    again = list(run_campaign(replace(plant, known=done[-2].calibration)))
    verdicts_of["wrong"] = told_of(plant, [*done[:-1], *again])
    assert verdicts_of["right"].findings.holds
    wrong = verdicts_of["wrong"].findings
    assert not wrong.holds
    (said,) = (finding for finding in wrong.findings if "least probable fit" in finding.what)
    assert said.verdict is Verdict.FAILS
    assert said.computed.endswith("9_bundle, bundle")


def told_of(plant: Plant, done: list[campaign.Done]) -> Told:
    return Told.of(plant, [Bagged(one.step, (), one.outcome, one.calibration) for one in done], None)


def ones(scale: float, *, numbers: int = 80, campaigns: int = 30, refused: str = "") -> list[One]:
    """Return what campaigns would give whose errors are ``scale`` times as large as stated."""
    rng = np.random.default_rng(5)
    made = []
    for seed in range(campaigns):
        found = tuple(
            Judged(f"sensors[0].probes[{k % 3}].tip[{k}]", "gap probe tip", "m", 0.0, (0.0, 1.0), pull, 1.0, "bundle")
            for k, pull in enumerate(scale * rng.normal(size=numbers))
        )
        squares = scale**2 * rng.chisquare(6, size=FRESH)
        still = scale * rng.normal(size=120)
        six = (1.0,) * 6
        made.append(
            One(
                seed=seed,
                refused="",
                claims=found,
                found=found,
                inside=float(np.mean(squares < 12.59)),
                normalised=float(np.mean(squares)),
                errors=(scale,) * 6,
                sigmas=six,
                before=six,
                still_inside=float(np.mean(np.abs(still) < 1.96)),
                still_errors=(scale,) * 6,
                still_sigmas=six,
            )
        )
    return [*made, One(99, refused)] if refused else made


def verdicts(campaigns: list[One]) -> list[Verdict]:
    return [finding.verdict for finding in findings_of_many(coverage_of("triad_diodes", campaigns))]


def test_right_uncertainties_hold_over_many_campaigns() -> None:
    coverage = coverage_of("triad_diodes", ones(1.0))
    assert coverage.pooled.value == pytest.approx(0.95, abs=0.02)
    assert coverage.campaigns == 30
    assert coverage.families[0].numbers == 80
    assert set(verdicts(ones(1.0))) == {Verdict.HOLDS}


@pytest.mark.parametrize("scale", [3.0, 1.3])
def test_too_small_uncertainties_fail_over_many_campaigns(scale: float) -> None:
    pooled, _, fresh, still = verdicts(ones(scale))
    assert pooled is fresh is still is Verdict.FAILS


def test_too_large_uncertainties_fail_over_many_campaigns() -> None:
    assert verdicts(ones(0.5))[0] is Verdict.FAILS


def test_one_wrong_number_among_many_fails() -> None:
    campaigns = ones(1.0)
    wrong = [
        replace(one, found=(replace(one.found[0], estimate=3.0 * one.found[0].estimate), *one.found[1:]))
        for one in campaigns
    ]
    assert verdicts(wrong)[:2] == [Verdict.HOLDS, Verdict.FAILS]


@pytest.mark.parametrize(("campaigns", "each"), [(6, 1), (6, 9), (40, 3)])
def test_the_interval_of_a_part_holds_it(campaigns: int, each: int) -> None:
    random = np.random.default_rng(9)
    held = []
    for _ in range(300):
        part = Figure.of(np.mean(random.random((campaigns, each)) < 0.95, axis=1))
        low, high = interval_of(part, campaigns, each)
        assert 0.0 <= low <= part.value <= high <= 1.0
        assert high - low > 0.0
        held.append(low <= 0.95 <= high)
    assert np.mean(held) >= 0.93


def test_the_interval_of_a_part_knows_that_numbers_of_a_campaign_may_fail_together() -> None:
    together = Figure.of(np.array([1.0] * 9 + [0.0]))
    assert interval_of(together, 10, 50) == pytest.approx(binomtest(9, 10).proportion_ci(method="exact"))
    everywhere = Figure.of(np.ones(6))
    assert interval_of(everywhere, 6, 50) == pytest.approx(binomtest(6, 6).proportion_ci(method="exact"))


def test_a_number_is_measured_by_the_step_that_lowered_its_uncertainty_most() -> None:
    def known(tip: float, axis: float, shift: float) -> Calibration:
        content = as_built("triad_diodes").model_dump(mode="json", exclude_defaults=True)
        probe = content["sensors"][0]["probes"][0]
        probe["tip"]["sigma"] = [tip, tip, 1e-5]
        probe["axis"]["sigma"] = axis
        probe["zero_shift"]["sigma"] = shift
        return calibration_from(content)

    built = known(5e-5, 3e-3, 0.0)
    after = [known(5e-5, 3e-3, 0.0), known(1e-6, 2.99e-3, 1e-3), known(0.5e-6, 2.98e-3, 1e-4)]
    found = determined(built, after)
    probe = "sensors[0].probes[0]"
    assert found == {f"{probe}.tip[0]": 1, f"{probe}.tip[1]": 1, f"{probe}.zero_shift": 1}


def test_a_refused_campaign_fails_and_is_quoted() -> None:
    first = findings_of_many(coverage_of("triad_diodes", ones(1.0, refused="bag: too few stops.")))[0]
    assert first.verdict is Verdict.FAILS
    assert first.remark == "bag: too few stops."


def test_an_interrupt_ends_many_campaigns() -> None:
    heard: list[int] = []

    def stop() -> None:
        heard.append(1)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        many_campaigns("triad_diodes", range(SEED, SEED + 20), workers=1, on_done=stop)
    assert heard == [1]
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("name", "family"),
    [
        ("sensors[0].probes[1].volts_to_gap[2]", "gap probe A_2"),
        ("sensors[0].probes[1].supply.sensitivity", "gap probe supply sensitivity"),
        ("sensors[1].probes[0].tip[0]", "ring probe tip"),
        ("sensors[1].maps.factory[0].x[1][1]", "diode map"),
        ("sensors[1].diodes[0].origin[2]", "diodes origin"),
        ("sensors[0].target_plane.tilt[0]", "target plane tilt"),
        ("sensors[1].ring.cos[3]", "ring cos"),
    ],
)
def test_families(name: str, family: str) -> None:
    assert family_of(name) == family
