# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings for calibration come out of real bags as they went in; what is wrong with a bag is one sentence."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.bags.calibration_recording import Reference, bag_sha256, load_recording
from posor.calibration.designs import STANDOFF
from posor.errors import BagError, PosorError, TrackError
from posor.model.scan import PROBES_ESTIMATED, SATURATED, Scan
from posor.numerics.stamps import NS
from posor.ros_names import POINT_STAMPED, POSE_STAMPED
from posor_calibration.procedures.gap_linearisation import GapLinearisationOptions, linearise_gap_probes
from posor_drivers.message_builder import header
from posor_lab.harness.calibration_bag import RAW, TYPES, Entry, entries, point, raw, scalar, transform, write_bag
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.simulated_recordings import diode_calibration, lifted_recording
from posor_msgs.msg import RawScan
from scipy.spatial.transform import Rotation

BAGS = Path(__file__).resolve().parent.parent / "bags"
BEGIN = 1_795_000_000 * NS


def scan(number: int, **fields: Any) -> Scan:
    usual: dict[str, Any] = {
        "number": number,
        "stamp_ns": BEGIN + number * 1_000_000,
        "gap_voltages": np.array([0.1, 0.2, 0.3]) * number,
        "ring_voltages": np.empty(0),
        "diode_currents": np.full((2, 4), 5e-5),
        "lit_sources": (0, 1),
    }
    return Scan(**(usual | fields))


SCANS = [raw(scan(number)) for number in (1, 2, 3)]
STAMPS = [BEGIN + 1_000_000, BEGIN + 2_000_000, BEGIN + 3_000_000]


def refused(path: Path, messages: Sequence[Entry], kind: type[PosorError], **options: Any) -> str:
    bag = write_bag(path / "bag", messages)
    return str(refusal(kind, load_recording, bag, **options)).replace(str(bag), "BAG")


def test_scans_come_as_they_were_recorded(tmp_path: Path) -> None:
    messages = [
        raw(scan(1, supply_voltage=15.1, temperature=293.0), status=SATURATED),
        raw(scan(2, ring_voltages=np.empty(0), gap_voltages=np.array([1.0, np.nan, 3.0]))),
        raw(scan(3, lit_sources=(4, 255)), status=RawScan.STATUS_HOME_BUMP),
    ]
    taken = load_recording(write_bag(tmp_path / "bag", messages))
    assert taken.scans.numbers.tolist() == [1, 2, 3]
    assert taken.scans.stamps_ns.tolist() == STAMPS
    np.testing.assert_array_equal(taken.scans.gap_voltages, [[0.1, 0.2, 0.3], [1.0, np.nan, 3.0], scan(3).gap_voltages])
    assert taken.scans.diode_currents.shape == (3, 2, 4)
    assert taken.scans.lit_sources.tolist() == [[0, 1], [0, 1], [4, 255]]
    np.testing.assert_array_equal(taken.scans.supply_voltages, [15.1, np.nan, np.nan])
    assert taken.scans.at_home.tolist() == [0, 0, 1]
    assert taken.statuses is not None
    assert taken.statuses.tolist() == [SATURATED, 0, RawScan.STATUS_HOME_BUMP]
    assert (taken.source, dict(taken.tracks)) == (str(tmp_path / "bag"), {})


def test_a_pose_stamped_is_a_reference_only_if_it_is_named(tmp_path: Path) -> None:
    orientation = TYPES.new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.6, w=0.8)
    pose = TYPES.new(
        "geometry_msgs/msg/Pose",
        position=TYPES.new("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0),
        orientation=orientation,
    )

    def stamped(frame: str, stamp_ns: int) -> Entry:
        message = TYPES.new(POSE_STAMPED, header=header(TYPES, stamp_ns, frame), pose=pose)
        return "/cmm", POSE_STAMPED, stamp_ns, message

    bag = write_bag(tmp_path / "one_frame", [*SCANS, *(stamped("receiving", stamp) for stamp in STAMPS)])
    assert load_recording(bag).tracks == {}
    track = load_recording(bag, named={"/cmm"}).tracks["/cmm"]
    assert track.stamps_ns.tolist() == STAMPS
    np.testing.assert_array_equal(track.values, [[1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]] * 3)
    mixed = [*SCANS, stamped("receiving", STAMPS[0]), stamped("base", STAMPS[1])]
    sentence = refused(tmp_path, mixed, TrackError, references=[Reference("/cmm")])
    assert sentence == "BAG, topic /cmm: poses in base, receiving; expected one frame only."
    point = TYPES.new("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0)
    points = [
        ("/cmm", POINT_STAMPED, stamp, TYPES.new(POINT_STAMPED, header=header(TYPES, stamp, frame), point=point))
        for frame, stamp in (("receiving", STAMPS[0]), ("base", STAMPS[1]))
    ]
    sentence = refused(tmp_path / "points", [*SCANS, *points], TrackError, references=[Reference("/cmm")])
    assert sentence == "BAG, topic /cmm: points in base, receiving; expected one frame only."


def test_references_come_by_type_with_their_stamps(tmp_path: Path) -> None:
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2], [0.0, 0.0, 0.3]]).as_quat()
    turns[1] *= -1.0  # the same rotation
    messages = [*SCANS]
    for n, stamp in enumerate(STAMPS):
        messages += [
            scalar("/interferometer", stamp, 1e-3 * n),
            point("/machine", stamp, (1.0 * n, 2.0, 3.0)),
            transform("/pose", stamp, (0.1, 0.2, 0.3 * n, *turns[n])),
        ]
    taken = load_recording(write_bag(tmp_path / "bag", messages))
    assert sorted(taken.tracks) == ["/interferometer", "/machine", "/pose"]
    for track in taken.tracks.values():
        assert track.stamps_ns.tolist() == STAMPS
    np.testing.assert_allclose(taken.tracks["/interferometer"].values[:, 0], [0.0, 1e-3, 2e-3])
    np.testing.assert_allclose(taken.tracks["/machine"].values[:, 0], [0.0, 1.0, 2.0])
    pose = taken.tracks["/pose"].values
    assert np.all(pose[:, 6] > 0.9)  # the sign is continued, so that they can be interpolated
    np.testing.assert_allclose(2.0 * np.arctan2(pose[:, 5], pose[:, 6]), [0.1, 0.2, 0.3])
    assert taken.tracks["/pose"].source == f"{tmp_path / 'bag'}, topic /pose"


def test_named_references_have_the_uncertainty_of_their_instrument(tmp_path: Path) -> None:
    messages = [*SCANS, *(point("/machine", stamp, (1.0, 2.0, 3.0)) for stamp in STAMPS)]
    messages += [scalar("/gauge", stamp, 1.0) for stamp in STAMPS]
    bag = write_bag(tmp_path / "bag", messages)
    taken = load_recording(bag, references=[Reference("/machine", (1e-6, 2e-6, 3e-6))])
    assert list(taken.tracks) == ["/machine"]
    assert taken.tracks["/machine"].sigmas.tolist() == [1e-6, 2e-6, 3e-6]
    alike = load_recording(bag, references=[Reference("/machine", (5e-6,)), Reference("/gauge")])
    assert alike.tracks["/machine"].sigmas.tolist() == [5e-6] * 3
    assert alike.tracks["/gauge"].sigmas.tolist() == [0.0]


@pytest.mark.parametrize("sigmas", [(1e-6, 2e-6), (-1e-6,), (float("nan"),)])
def test_uncertainty_that_fits_no_quantity_is_refused(tmp_path: Path, sigmas: tuple[float, ...]) -> None:
    messages = [*SCANS, point("/machine", STAMPS[0], (1.0, 2.0, 3.0))]
    sentence = refused(tmp_path, messages, TrackError, references=[Reference("/machine", sigmas)])
    assert sentence.startswith("BAG, topic /machine: standard uncertainty ")
    assert sentence.endswith("; expected one number, or 3, of zero or more.")


def test_bags_of_1985_can_be_read() -> None:
    taken = load_recording(BAGS / "yzmo")
    assert len(taken.scans) == 14
    assert len(taken.tracks["/truth/machining_centre"].stamps_ns) == 14
    assert taken.statuses is not None
    assert np.count_nonzero(taken.statuses & PROBES_ESTIMATED) == 1
    np.testing.assert_array_equal(taken.tracks["/truth/machining_centre"].stamps_ns, taken.scans.stamps_ns)


def test_hash_is_what_sha256sum_says(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", SCANS)
    summed = subprocess.run(["sha256sum", "bag_0.mcap", "metadata.yaml"], cwd=bag, capture_output=True, check=True)  # noqa: S607
    again = subprocess.run(["sha256sum"], input=summed.stdout, capture_output=True, check=True)  # noqa: S607
    assert load_recording(bag).sha256 == again.stdout.decode().split()[0]
    alone = subprocess.run(["sha256sum", "bag_0.mcap"], cwd=bag, capture_output=True, check=True)  # noqa: S607
    assert load_recording(bag / "bag_0.mcap").sha256 == alone.stdout.decode().split()[0]
    moved = bag.rename(tmp_path / "moved")
    (moved / "notes.txt").write_text("not part of it")
    assert bag_sha256(moved) == again.stdout.decode().split()[0]


def test_joint_is_chosen_by_its_topic(tmp_path: Path) -> None:
    messages = [*SCANS, raw(scan(7), topic="/joint2/raw")]
    bag = write_bag(tmp_path / "two", messages)
    assert load_recording(bag, topic="/joint2/raw").scans.numbers.tolist() == [7]
    assert refused(tmp_path, messages, BagError) == (
        "BAG: scans are on 2 topics; expected the topic of the scans as one of /joint1/raw, /joint2/raw."
    )


THERE = "/joint1/raw (posor_msgs/msg/RawScan)"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"topic": "/none"}, f"BAG: there is no topic /none; expected one of {THERE}."),
        ({"references": [Reference("/none")]}, f"BAG: there is no topic /none; expected one of {THERE}."),
        (
            {"references": [Reference(RAW)]},
            (
                "BAG: topic /joint1/raw is of type posor_msgs/msg/RawScan; expected geometry_msgs/msg/PointStamped or "
                "geometry_msgs/msg/PoseStamped or geometry_msgs/msg/TransformStamped or "
                "posor_msgs/msg/ReferenceReading or std_msgs/msg/Float64."
            ),
        ),
    ],
)
def test_topic_that_is_not_there_or_does_not_serve_is_refused(
    tmp_path: Path, options: dict[str, Any], sentence: str
) -> None:
    assert refused(tmp_path, SCANS, BagError, **options) == sentence


IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
PLACE = (1.0, 2.0, 3.0)
SHAPES = "%d gap voltages, 0 ring voltages, 2 diodes of 4 currents, 2 lit sources"


def of_other_plate(entry: Entry) -> Entry:
    """Return a scan of another receiving plate, as of two recordings in one bag."""
    entry[3].header.frame_id = "other"
    return entry


@pytest.mark.parametrize(
    ("messages", "sentence"),
    [
        ([SCANS[0], raw(scan(2, gap_voltages=np.zeros(2)))], f"scan 2 has {SHAPES % 2}; expected {SHAPES % 3}."),
        ([raw(scan(1), diode_currents=np.zeros(7))], "scan 1 has 7 diode currents; expected 4 for each diode."),
        (
            [SCANS[0], of_other_plate(raw(scan(2, stamp_ns=10**9)))],
            "scans are of the receiving plates 'other' and 'receiving'; expected those of one POSOR.",
        ),
        (
            [raw(scan(1, stamp_ns=200)), raw(scan(2, stamp_ns=100), delay_ns=9_000_000)],
            "scan 2 is stamped 100 ns, scan 1 before it 200 ns; expected stamps that increase.",
        ),
        ([raw(scan(1, stamp_ns=0))], "scan 1 has no stamp; expected the middle of its exposure."),
        (
            [*SCANS, point("/machine", 300, PLACE), point("/machine", 200, PLACE, delay_ns=9_000_000)],
            "stamp 200 ns follows 300 ns; expected strictly increasing stamps.",
        ),
        (
            [*SCANS, point("/machine", 300, (1.0, float("inf"), 3.0))],
            "the value at 300 ns is not finite; expected finite values.",
        ),
        (
            [*SCANS, point("/machine", 0, PLACE)],
            "the first message has no stamp; expected the time of the measurement.",
        ),
        (
            [*SCANS, transform("/machine", 300, (*IDENTITY[:6], 2.0))],
            "rotation 1 has the length 2; expected a unit quaternion.",
        ),
        (
            [*SCANS, transform("/machine", 300, IDENTITY), transform("/machine", 400, IDENTITY, child="other")],
            "transforms between receiving to other, receiving to target; expected two frames only.",
        ),
    ],
)
def test_messages_that_cannot_be_used_are_refused(tmp_path: Path, messages: Sequence[Entry], sentence: str) -> None:
    topic, kind = ("/joint1/raw", BagError) if sentence.startswith("scan") else ("/machine", TrackError)
    assert refused(tmp_path, messages, kind) == f"BAG, topic {topic}: {sentence}"


def test_path_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    error = refusal(BagError, load_recording, tmp_path / "none")
    assert (error.where.endswith("none"), error.what) == (True, "does not exist")
    file = tmp_path / "notes.txt"
    file.write_text("no bag")
    assert "is no file that ends in .mcap or .db3" in str(refusal(BagError, load_recording, file))


def test_linearisation_from_a_bag_is_that_from_memory(tmp_path: Path) -> None:
    lifts = STANDOFF + np.linspace(-0.4e-3, 0.4e-3, 13)
    there = lifted_recording(diode_calibration(), lifts, np.random.default_rng(3), sigma=50e-9)
    bag = write_bag(tmp_path / "campaign", entries(there))
    back = load_recording(bag, references=[Reference("/reference", (50e-9,))])
    options = GapLinearisationOptions(reference="/reference", order=4)
    direct, read = (linearise_gap_probes(one, diode_calibration(), options) for one in (there, back))
    assert [new.value for new in direct.replacements] == [new.value for new in read.replacements]
    assert len(back.sha256) == 64
