# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arms in a shop: a few in CI, ``make shop`` draws many."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from posor import load_arm
from posor.bags.arm_estimator import ArmEstimator
from posor.bags.bag_writer import BagWriter
from posor.bags.data_frames import endpoint_columns
from posor.bags.offline_pipeline import estimate_bag, topics_of
from posor.bags.reprocess_task import Settings
from posor.chain.arm_file import load_arm_file
from posor.correction.correct_command import main as correct
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.shop.shop_arm import write_shop_arm
from posor_lab.shop.shop_command import failures, figures
from posor_lab.shop.shop_study import IN_THE_SHOP, WITH, WITHOUT, WRONG_SIGN, CaseSample, ShopSampler

ARMS, POSES = 16, 3


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_shop_arm(load_arm_file("five_axis"), tmp_path_factory.mktemp("shop"))


@pytest.fixture(scope="module")
def drawn(path: Path) -> Mapping[str, CaseSample]:
    return ShopSampler(path, POSES).draw(range(7, 7 + ARMS))


def test_thermometers_lower_the_error_tenfold_and_the_region_is_covered(drawn: Mapping[str, CaseSample]) -> None:
    assert drawn[WITHOUT].rms_m > 10.0 * drawn[WITH].rms_m
    for case in (WITH, WITHOUT):
        assert drawn[case].inside.value > 0.8
    assert drawn[WRONG_SIGN].inside.value < 0.3
    assert drawn[WRONG_SIGN].rms_m > 1.5 * drawn[WITHOUT].rms_m


def test_the_program_finds_a_wrong_sign_and_a_wrong_coverage(drawn: Mapping[str, CaseSample]) -> None:
    good = {WITH: {"rms_m": 1.0, "inside": 0.95}, WITHOUT: {"rms_m": 11.0, "inside": 0.94}}
    good[WRONG_SIGN] = {"rms_m": 20.0, "inside": 0.1}
    assert not failures(good, good)
    wrong = {**good, WITH: figures(drawn)[WRONG_SIGN]}
    wrong[WITH]["rms_m"] *= good[WITHOUT]["rms_m"] / drawn[WITHOUT].rms_m
    assert len(failures(wrong, good)) == 2
    assert len(failures(good, wrong)) == 1
    assert len(failures({**good, WRONG_SIGN: good[WITH]}, good)) == 1


def write_bag(simulation: ArmSimulation, ticks: range, folder: Path, *, thermometers: bool) -> Path:
    """Write the scans of ticks, and of the thermometers, into a bag; return the bag."""
    types, rate = MessageTypes(), simulation.scenario.ticks_per_second
    make = SimulatedMessages(types, simulation)
    scans = {joint: simulation.scans(joint, np.array(ticks)) for joint in simulation.joints}
    with BagWriter(folder) as writer:
        for joint in simulation.joints:
            topic = f"/{simulation.arm.name}/{joint}/{RAW_TOPIC}"
            writer.add_topic(topic, RAW_SCAN, types.definition(RAW_SCAN))
        for n, tick in enumerate(ticks):
            stamp_ns = tick_stamp_ns(tick, rate)
            for beam, kelvin in simulation.temperatures(tick).items() if thermometers else ():
                message = make.temperature(beam, stamp_ns, kelvin, 0.05)
                kind = make.topics.temperature(beam).type_name
                writer.add_topic(message.topic, kind, types.definition(kind))
                writer.write(message.topic, stamp_ns, message.data)
            for joint, each in scans.items():
                data = make.raw_scan(joint, each, n).data
                writer.write(f"/{simulation.arm.name}/{joint}/{RAW_TOPIC}", stamp_ns, data)
    return writer.path


def test_a_recording_is_estimated_at_the_recorded_temperatures(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = load_arm(path)
    simulation = ArmSimulation(arm, IN_THE_SHOP, rate=50, truth="independent")
    ticks = range(100_000 * 50, 100_000 * 50 + 200)
    true = simulation.truth(np.array(ticks)).endpoint.translations
    for thermometers in (True, False):
        bag = write_bag(simulation, ticks, tmp_path / f"bag_{thermometers}", thermometers=thermometers)
        estimator = ArmEstimator(Settings.of_arm(arm))
        topics = topics_of(bag, Settings.of_arm(arm).joints, estimator.thermometers)
        parts = [part.endpoint for part in estimate_bag(bag, topics, estimator)]
        (_, summary), notes = estimator.summarise(), estimator.notes()
        assert summary is not None
        found = arm.estimate(bag).endpoint
        np.testing.assert_array_equal(found.poses, np.concatenate([part.poses for part in parts]))
        known = np.isin(tick_stamp_ns(np.array(ticks), 50), found.stamps_ns)  # the first scans count theta
        error = np.linalg.norm(found.poses[:, :3] - true[known], axis=1)
        sigma = np.sqrt(np.trace(found.covariances()[:, :3, :3], axis1=1, axis2=2))
        cold = found.stamps_ns // NS < 100_001 if thermometers else np.ones(len(found), dtype=bool)
        assert (len(found), summary.degraded) == (known.sum(), cold.sum())
        np.testing.assert_array_equal(endpoint_columns(found)["degraded"], cold)
        assert len(found) > 190
        assert error[cold].min() > 200e-6
        assert np.all(error < 4.0 * sigma)
        assert error[~cold].max(initial=0.0) < 50e-6
        sentences = [
            f"thermometer '{name}' of beam '{name}' has no reading whose stamp is at most 5 s old"
            for name in simulation.thermometers
        ]
        assert notes == [f"{'; '.join(sentences)}: {summary.degraded} of {len(found)} poses"]
        assert len(topics.notes) == (0 if thermometers else len(sentences))
    joints = ",".join(f"{name} [rad]" for name in arm.calibrations)
    (tmp_path / "program.csv").write_text(f"time [s],{joints}\n0{',0' * 5}\n1{',0' * 5}\n", encoding="utf-8")
    options = ["--bag", str(tmp_path / "bag_False"), "--output", str(tmp_path / "corrected.csv")]
    assert correct([str(path), str(tmp_path / "program.csv"), *options]) == 1
    assert f"0 of {len(found)} endpoints can be used, {len(found)} are DEGRADED; expected" in capsys.readouterr().err
