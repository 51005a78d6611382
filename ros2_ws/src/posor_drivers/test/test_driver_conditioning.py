"""The driver node as a program that makes one scan of five, received over DDS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_drivers.driver_node import DriverNode
from posor_drivers.scan_groups import stamp_of
from posor_estimator.testing.graph import Graph
from posor_estimator.testing.program import Program, installed, ros_arguments
from posor_estimator.testing.refusal import refusal
from posor_msgs.msg import RawScan

from .bags import SECOND, Record, scan, write_bag

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("ros_domain")

START = 1000 * SECOND
TICK = SECOND // 1000
GROUPS = 40
SAMPLES = 5
NOISE_V, NOISE_A = 1e-3, 1e-8
OUTLIER_GROUP, OUTLIER_SAMPLE = 7, 3
LOSSLESS = {"qos_reliability": "reliable", "qos_depth": 0, "rate": 0.0}
NODE = "node /joint1/driver_node"


def named(bag: Path, **parameters: Any) -> dict[str, object]:
    conditioning = {f"conditioning.{name}": value for name, value in parameters.items()}
    return {**conditioning, "source": "bag", "bag.path": str(bag), **LOSSLESS}


def driver(bag: Path, **parameters: Any) -> Program:
    return Program([*installed("posor_drivers", "driver_node"), *ros_arguments(named(bag, **parameters), "/joint1")])


def received(bag: Path, count: int, **parameters: Any) -> list[RawScan]:
    with Graph() as graph:
        scans = graph.collect(RawScan, "/joint1/raw")
        with driver(bag, **parameters) as program:
            graph.wait_until(lambda: len(scans) == count, f"{count} scans")
            assert program.wait() == 0
            assert program.stderr == []
        return scans


def noisy(count: int) -> tuple[Any, Any]:
    """Return voltages (count, 3) and currents (count, 8) with one outlier among the voltages."""
    random = np.random.default_rng(1985)
    volts = random.normal([0.25, 0.5, 0.75], NOISE_V, (count, 3))
    volts[OUTLIER_GROUP * SAMPLES + OUTLIER_SAMPLE, 1] += 0.4
    return volts, random.normal(5e-5, NOISE_A, (count, 8))


@pytest.mark.parametrize("method", ["mean", "trimmed"])
def test_noisy_samples_of_a_bag_become_scans(tmp_path: Path, method: str) -> None:
    count = GROUPS * SAMPLES + 2
    volts, currents = noisy(count)
    records = [
        scan(n, START + n * TICK, gap_voltages=volts[n], diode_currents=currents[n], status=RawScan.STATUS_SIMULATED)
        for n in range(count)
    ]
    bag = write_bag(tmp_path / "bag", records)
    results = received(bag, GROUPS + 1, method=method, samples=SAMPLES)
    assert [result.scan for result in results] == [*range(2, 5 * GROUPS, 5), 5 * GROUPS]
    assert [stamp_of(result) - START for result in results] == [
        *(n * TICK for n in range(2, 5 * GROUPS, 5)),
        5 * GROUPS * TICK + TICK // 2,
    ]
    flagged = []
    for group, result in enumerate(results):
        part = slice(group * SAMPLES, group * SAMPLES + SAMPLES)
        dropped = bool(result.status & RawScan.STATUS_OUTLIERS_DROPPED)
        flagged += [group] if dropped else []
        assert result.status & ~RawScan.STATUS_OUTLIERS_DROPPED == RawScan.STATUS_SIMULATED
        assert result.samples == len(volts[part]) - dropped
        if not dropped:
            np.testing.assert_allclose(result.gap_voltages, volts[part].mean(axis=0), rtol=1e-13)
            np.testing.assert_allclose(result.gap_voltage_spreads, volts[part].std(axis=0, ddof=1), rtol=1e-9)
            np.testing.assert_allclose(result.diode_currents, currents[part].mean(axis=0), rtol=1e-13)
            np.testing.assert_allclose(result.diode_current_spreads, currents[part].std(axis=0, ddof=1), rtol=1e-9)
    assert (OUTLIER_GROUP in flagged) == (method == "trimmed")
    if method == "mean":
        assert flagged == []
        return
    kept = [OUTLIER_GROUP * SAMPLES + n for n in range(SAMPLES) if n != OUTLIER_SAMPLE]
    assert results[OUTLIER_GROUP].gap_voltages[1] == pytest.approx(volts[kept, 1].mean(), rel=1e-13)
    assert results[OUTLIER_GROUP].gap_voltage_spreads[1] == pytest.approx(volts[kept, 1].std(ddof=1), rel=1e-9)


def test_dark_samples_of_a_bag_are_subtracted(tmp_path: Path) -> None:
    net, background = np.linspace(1e-5, 8e-5, 8), np.linspace(3e-6, 1e-6, 8)
    records: list[Record] = []
    for n in range(21):
        lit = n % 2 == 1
        sources = np.array([0, 1] if lit else [255, 255], dtype=np.uint8)
        currents = background * (1.0 + 0.05 * n) + (net if lit else 0.0)
        records.append(scan(n, START + n * TICK, gap_voltages=np.ones(3), diode_currents=currents, lit_sources=sources))
    bag = write_bag(tmp_path / "bag", records)
    results = received(bag, 2, method="mean", samples=SAMPLES, subtract_dark=True)
    assert [(result.scan, result.samples) for result in results] == [(5, 5), (15, 5)]
    for result in results:
        assert result.status == RawScan.STATUS_DARK_SUBTRACTED
        np.testing.assert_allclose(result.diode_currents, net, rtol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        (
            {"method": "median"},
            f"{NODE}, parameter 'conditioning.method': 'median' is wrong; expected one of 'none', 'mean', 'trimmed'.",
        ),
        (
            {"method": "mean", "samples": 0},
            f"{NODE}, parameter 'conditioning.samples': 0 is wrong; expected an integer at least 1 and at most 1000.",
        ),
        (
            {"method": "mean"},
            f"{NODE}: 'conditioning.samples' 1 is too few for 'conditioning.method' 'mean'; expected at least 2.",
        ),
        (
            {"method": "trimmed", "samples": 2},
            f"{NODE}: 'conditioning.samples' 2 is too few for 'conditioning.method' 'trimmed'; expected at least 3.",
        ),
        (
            {"samples": 5},
            (
                f"{NODE}: 'conditioning.samples' is 5 but 'conditioning.method' is 'none'; "
                "expected method 'mean' or 'trimmed', or 1 sample."
            ),
        ),
        (
            {"method": "trimmed", "samples": 5, "significance": 0.0},
            (
                f"{NODE}, parameter 'conditioning.significance': 0.0 is wrong; "
                "expected a number greater than 0.0 and at most 0.2."
            ),
        ),
        (
            {"subtract_dark": "yes"},
            f"{NODE}, parameter 'conditioning.subtract_dark': 'yes' is wrong; expected true or false.",
        ),
        (
            {"sample": 5},
            (
                f"{NODE}, parameter 'conditioning.sample': there is no such parameter; "
                "expected perhaps 'conditioning.samples'."
            ),
        ),
    ],
)
def test_wrong_parameters_are_refused_with_one_sentence(
    tmp_path: Path, parameters: dict[str, Any], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", [scan(0, START)])
    assert refusal(DriverNode, named(bag, **parameters), capfd, "/joint1") == (2, [sentence])
