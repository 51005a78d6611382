# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Beams at the temperatures of their thermometers; thermometers of beams and plates that cannot be used."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from posor.chain.beam_temperatures import CELSIUS, BeamTemperatures
from posor.chain.beams_file import BeamsFile
from posor.chain.kinematic_chain import Chain
from posor.errors import ChainError
from posor.numerics.stamps import NS
from posor_lab.harness.beams import quantity

REFERENCE, ALPHA, SPREAD, LENGTH, UNCERTAINTY = 293.0, 20e-6, 2.0, 0.5, 0.1
NAMES = "abcd"
OLD = "has no reading whose stamp is at most 4 s old"
URDF = "<robot name='arm'><link name='base'/>{}</robot>".format(
    "".join(
        f"<link name='r{n}'/><link name='t{n + 1}'/><joint name='beam_{n}' type='fixed'><parent link='{start}'/>"
        f"<child link='r{n}'/><origin xyz='{LENGTH} 0 0'/></joint><joint name='joint_{n}' type='floating'>"
        f"<parent link='r{n}'/><child link='t{n + 1}'/></joint>"
        for n, start in enumerate(["base", "t1", "t2", "t3"])
    )
)


def thermometer_of(name: str, neighbour: str = " ") -> dict[str, Any]:
    """Return a thermometer without a reference; a space: no neighbour."""
    thermometer = {
        "name": name,
        "uncertainty": quantity(UNCERTAINTY, "K"),
        "range": quantity([273.0, 313.0], "K"),
        "rate": quantity(0.5, "K/s"),
        "age": quantity(4.0, "s"),
    }
    if neighbour != " ":
        thermometer["neighbour"] = {"name": neighbour, "difference": quantity(3.0, "K")}
    return thermometer


def chain_with(neighbours: str = "badc", *, thermometers: bool = True, plates: str = "") -> Chain:
    """Return four beams of the same direction; the thermometers have these neighbours, a space: no neighbour.

    ``plates``: neighbours of the thermometers ``plate_0``, ... of the first plates.
    """
    beams = []
    for n, (name, neighbour) in enumerate(zip(NAMES, neighbours, strict=True)):
        thermometer = thermometer_of(name, neighbour) | {"reference": quantity(REFERENCE, "K")}
        temperature = {
            "coefficient": {**quantity(ALPHA, "1/K"), "sigma": 0.01 * ALPHA},
            "deviation": quantity(10.0, "K"),
            "spread": quantity(SPREAD, "K"),
            "gradient": {"along": quantity(0.2, "K"), "across": quantity(0.1, "K"), "width": quantity(0.05, "m")},
            "thermometer": thermometer if thermometers else None,
        }
        zero = {"position": quantity([0.0] * 3, "m"), "orientation": quantity([0.0] * 3, "rad")}
        beams.append({"joint": f"beam_{n}", "uncertainty": zero, "temperature": temperature})
    shared = {
        name: {"uncertainty": quantity(sigma, "K"), "change": {f"beam_{n}.{key}": quantity(1.0, "1") for n in range(4)}}
        for name, sigma, key in (("shop", 5.0, "temperature"), ("scale", 0.05, "thermometer"))
        if thermometers or key == "temperature"
    }
    provenance = {"source": "test", "method": "none", "date": "none"}
    head = {"format": "posor_beams", "version": 3, "name": "test", "provenance": provenance}
    warm_plates = [
        {"joint": f"joint_{n}", "thermometer": thermometer_of(f"plate_{n}", neighbour)}
        for n, neighbour in enumerate(plates)
    ]
    content = {**head, "beams": beams, "shared": shared, "plates": warm_plates}
    return Chain(URDF, "t4", BeamsFile.model_validate(content))


class Rig:
    """An estimator with exact joints, and its beams."""

    def __init__(self, neighbours: str = "badc", plates: str = "") -> None:
        chain = chain_with(neighbours, plates=plates)
        self.beams, self.estimator = chain.beams, chain.estimator()
        self.estimator.poses[:] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        self.estimator.covariances_random[:] = self.estimator.covariances_systematic[:] = 0.0
        self.temperatures = BeamTemperatures(chain.beams, self.estimator, chain.plates)

    def run(self, kelvins: Callable[[str, int], float | None], begin: int, end: int, stamp: int | None = None) -> None:
        """Read thermometers each second; ``stamp``: of all readings [s]; None: the second."""
        for second in range(begin, end):
            for name in self.temperatures.names:
                if (kelvin := kelvins(name, second)) is not None:
                    stamp_ns = (second if stamp is None else stamp) * NS
                    self.temperatures.add(name, stamp_ns, kelvin - CELSIUS)
            self.temperatures.update(second * NS)
        assert self.estimator.estimate(end * NS)


def quiet(name: str, second: int) -> float:
    """Return readings of a sound thermometer: they are never exactly the same."""
    return 295.0 + 0.01 * ((second + ord(name[-1])) % 3)


def test_each_beam_has_the_length_of_its_temperature_and_the_covariance_of_what_is_unknown() -> None:
    rig, cold = Rig(), 4.0 * LENGTH
    rig.run(lambda _name, _second: None, 10, 11)
    assert rig.estimator.pose[0] == cold
    alone, shop = 4.0 * (ALPHA * SPREAD * LENGTH) ** 2, (4.0 * ALPHA * 5.0 * LENGTH) ** 2
    assert rig.estimator.covariance_systematic[0, 0] == pytest.approx(alone + shop)
    bend = ALPHA * 0.1 / 0.05 * LENGTH
    assert rig.estimator.covariance_systematic[3:, 3:] == pytest.approx(np.diag([0.0, 4.0 * bend**2, 4.0 * bend**2]))
    lever = LENGTH * (np.arange(4) + 0.5)  # an arc moves the line of its end about its middle
    assert rig.estimator.covariance_systematic[1, 1] == pytest.approx(bend**2 * np.sum(lever**2))
    rig.run(lambda name, _second: REFERENCE + 2.0 + NAMES.index(name), 11, 14)
    assert not rig.temperatures.reason
    changes = 2.0 + np.arange(4)
    assert rig.estimator.pose[0] == pytest.approx(LENGTH * np.sum(1.0 + ALPHA * changes), rel=1e-15)
    kelvins = UNCERTAINTY**2 + 0.2**2 + (0.5 * 4.0) ** 2 / 3.0 + (0.01 * changes) ** 2
    expected = (ALPHA * LENGTH) ** 2 * (np.sum(kelvins) + (4.0 * 0.05) ** 2)
    assert rig.estimator.covariance_systematic[0, 0] == pytest.approx(expected)
    assert [beam.expansion[0] for beam in rig.beams] == pytest.approx([ALPHA * 10.0 * LENGTH] * 4)
    warm = [beam.at_temperature(REFERENCE + 2.0) for beam in (rig.beams[0], chain_with("    ").beams[0])]
    # Neighbours find an error above twice their difference; without one, only the range of the beam is known.
    assert [beam.expansion[0] / ALPHA / LENGTH for beam in warm] == pytest.approx([2.0 * 3.0 + 0.5 * 4.0, 10.0 + 2.0])


def test_a_beam_without_a_thermometer_has_the_spread_too() -> None:
    estimator, spread = chain_with(thermometers=False).estimator(), Rig()
    spread.run(lambda _name, _second: None, 10, 11)
    for name in ("poses", "covariances_random", "covariances_systematic"):
        getattr(estimator, name)[:] = getattr(spread.estimator, name)
    assert estimator.estimate()
    np.testing.assert_array_equal(estimator.covariance_systematic, spread.estimator.covariance_systematic)


def only(names: str, changed: Callable[[int], float | None]) -> Callable[[str, int], float | None]:
    """Return readings of which those of some thermometers are changed."""
    return lambda name, second: changed(second) if name in names else quiet(name, second)


def rising(name: str, second: int) -> float:
    return quiet("a", 10) if name == "a" else quiet(name, second) + 0.1 * (second - 10)


def swapped(name: str, second: int) -> float:
    """Return readings of two warm and two cold beams, two of which are exchanged."""
    return quiet(name, second) + (6.0 if name in "bc" else 0.0)


FAULTS: list[tuple[Callable[[str, int], float | None], dict[str, str]]] = [
    (quiet, {}),
    (only("a", lambda _: None), {"a": OLD}),
    (only("a", lambda s: 295.0 if s < 16 else None), {"a": OLD}),
    (only("b", lambda _: math.nan), {"b": "does not read a number"}),
    (only("b", lambda s: 295.0 if s < 20 else math.inf), {"b": "does not read a number"}),
    (only("c", lambda _: 22.0), {"c": "reads a temperature outside 273 to 313 K"}),
    (only("c", lambda _: 273.15 + 295.0), {"c": "reads a temperature outside 273 to 313 K (in kelvin?)"}),
    (only("c", lambda _: 273.15 + 71.6), {"c": "reads a temperature outside 273 to 313 K (in degrees Fahrenheit?)"}),
    (only("c", lambda s: 295.0 if s < 14 else 299.0), {"c": "changes faster than 0.5 K/s"}),
    (rising, {"a": "still reads the same after 'b' has changed by more than 1 K"}),
    (
        only("d", lambda s: 295.0 + 0.3 * (s - 10)),
        {"c": "differs from 'd' by more than 3 K", "d": "differs from 'c' by more than 3 K"},
    ),
    (swapped, {n: f"agrees with the neighbours if exchanged with '{'cdab'[k]}'" for k, n in enumerate(NAMES)}),
]


@pytest.mark.parametrize(("kelvins", "faults"), FAULTS)
def test_a_thermometer_that_cannot_be_used_is_named_and_its_beam_has_the_spread(
    kelvins: Callable[[str, int], float | None], faults: dict[str, str]
) -> None:
    rig, healthy = Rig(), Rig()
    rig.run(kelvins, 10, 25)
    healthy.run(lambda name, second: None if name in faults else kelvins(name, second), 10, 25)
    assert rig.temperatures.faults == faults
    sentences = [f"thermometer '{name}' of beam 'beam_{NAMES.index(name)}' {text}" for name, text in faults.items()]
    assert rig.temperatures.reason == "; ".join(sentences)
    np.testing.assert_array_equal(rig.estimator.pose, healthy.estimator.pose)
    np.testing.assert_array_equal(rig.estimator.covariance_systematic, healthy.estimator.covariance_systematic)


def of_plate(changed: Callable[[int], float | None]) -> Callable[[str, int], float | None]:
    """Return readings of which those of one plate are changed."""
    return lambda each, second: changed(second) if each == "plate_1" else quiet(each, second)


def swapped_plates(name: str, second: int) -> float:
    """Return readings of a warm joint and a cold one whose plates' thermometers are exchanged."""
    return quiet(name, second) + (6.0 if name in {"c", "d", "plate_0"} else 0.0)


def shop_warms_up(name: str, second: int) -> float:
    return quiet(name, 10 if name == "plate_0" else second) + 0.1 * (second - 10) * (name != "plate_0")


PLATE_FAULTS: list[tuple[Callable[[str, int], float | None], dict[str, str]]] = [
    (quiet, {}),
    (of_plate(lambda _: None), {"plate_1": OLD}),
    (of_plate(lambda _: math.nan), {"plate_1": "does not read a number"}),
    (of_plate(lambda _: -999.0), {"plate_1": "reads a temperature outside 273 to 313 K"}),
    (of_plate(lambda s: 295.0 if s < 14 else 299.0), {"plate_1": "changes faster than 0.5 K/s"}),
    (of_plate(lambda s: 295.0 + 0.3 * (s - 10)), {"plate_1": "differs from 'd' by more than 3 K"}),
    (shop_warms_up, {"plate_0": "still reads the same after 'a' has changed by more than 1 K"}),
    (swapped_plates, {f"plate_{n}": f"agrees with the neighbours if exchanged with 'plate_{1 - n}'" for n in range(2)}),
]


@pytest.mark.parametrize(("kelvins", "faults"), PLATE_FAULTS)
def test_a_thermometer_of_a_plate_is_named_and_does_not_move_the_beams(
    kelvins: Callable[[str, int], float | None], faults: dict[str, str]
) -> None:
    rig, without = Rig(plates="ad"), Rig()
    rig.run(kelvins, 10, 25)
    without.run(kelvins, 10, 25)
    assert rig.temperatures.faults == faults
    sentences = [f"thermometer '{name}' of the plate of 'joint_{name[-1]}' {text}" for name, text in faults.items()]
    assert rig.temperatures.reason == "; ".join(sentences)
    np.testing.assert_array_equal(rig.estimator.pose, without.estimator.pose)
    np.testing.assert_array_equal(rig.estimator.covariance_systematic, without.estimator.covariance_systematic)


def test_the_plate_of_an_unknown_joint_is_refused() -> None:
    with pytest.raises(ChainError, match=r"'joint_4' is not a POSOR of the arm; expected one of joint_0, joint_1"):
        chain_with(plates="    a")


def test_of_three_neighbours_the_one_that_differs_is_named() -> None:
    rig = Rig("bcb ")
    rig.run(only("a", lambda s: 295.0 + 0.3 * (s - 10)), 10, 25)
    assert rig.temperatures.faults == {"a": "differs from 'b' by more than 3 K"}


def test_waiting_does_not_widen_what_is_accepted_but_a_return_and_a_restart_do() -> None:
    rig = Rig()
    jump = only("c", lambda s: 295.0 if s < 14 or 60 <= s < 70 else 299.0)
    rig.run(jump, 10, 60)
    assert list(rig.temperatures.faults) == ["c"]
    rig.run(jump, 60, 70)
    assert not rig.temperatures.faults
    rig.run(jump, 70, 80)
    assert list(rig.temperatures.faults) == ["c"]
    rig.temperatures.restart()
    rig.run(lambda name, second: quiet(name, second) + 4.0, 80, 84)
    assert not rig.temperatures.faults


def test_a_frozen_thermometer_that_moves_again_is_used_again() -> None:
    rig = Rig()
    rig.run(rising, 10, 30)
    assert list(rig.temperatures.faults) == ["a"]
    rig.run(lambda name, second: rising(name if name != "a" else "b", second), 30, 33)
    assert not rig.temperatures.faults


def test_stamps_that_stay_or_are_ahead_of_the_scans_are_named() -> None:
    rig = Rig()
    rig.run(lambda name, _second: quiet(name, 0), 10, 20, stamp=9)
    assert set(rig.temperatures.faults.values()) == {OLD}
    rig = Rig()
    rig.run(quiet, 10, 20, stamp=90)
    assert set(rig.temperatures.faults.values()) == {OLD}


def test_a_reading_in_the_frame_of_another_thermometer_is_not_used() -> None:
    rig = Rig()
    rig.run(quiet, 10, 14)
    rig.temperatures.add("a", 14 * NS, 22.0, "b")
    rig.run(only("a", lambda _: None), 14, 16)
    assert rig.temperatures.faults == {"a": "receives the readings of 'b'"}


def test_readings_of_two_publishers_are_not_used() -> None:
    twice = "has two readings of one stamp; expected one publisher, and a clock that runs"
    rig = Rig()
    rig.run(quiet, 10, 14)
    for celsius in (22.0, 21.9):
        rig.temperatures.add("a", 14 * NS, celsius)
    rig.run(only("a", lambda _: None), 14, 16)
    assert rig.temperatures.faults == {"a": twice}
    rig.run(quiet, 16, 18)
    assert not rig.temperatures.faults
    rig.run(quiet, 18, 20, stamp=18)
    assert set(rig.temperatures.faults.values()) == {twice}
    rig.temperatures.add("a", 20 * NS, 22.0, publishers=2)
    rig.run(only("a", lambda _: None), 20, 22)
    assert rig.temperatures.faults["a"] == "has 2 publishers on its topic; expected one"


def test_a_replay_that_starts_again_forgets_its_readings() -> None:
    rig = Rig()
    rig.run(quiet, 10, 20)
    assert rig.temperatures.kelvins
    rig.temperatures.update(5 * NS)
    assert set(rig.temperatures.faults.values()) == {OLD}
    rig.run(lambda name, second: quiet(name, second) + 8.0, 6, 9)
    assert not rig.temperatures.faults


def test_readings_enter_at_whole_seconds_once_they_are_half_a_second_old() -> None:
    rig = Rig()
    used = []
    rig.temperatures.add("a", int(10.3 * NS), 20.0)
    for second in (10.4, 10.9, 11.0, 11.2):
        rig.temperatures.update(int(second * NS))
        used.append("a" in rig.temperatures.kelvins)
    rig.temperatures.add("a", int(10.6 * NS), 20.1)
    for second in (11.9, 12.0):
        rig.temperatures.update(int(second * NS))
        used.append(rig.temperatures.kelvins["a"] == pytest.approx(293.25))
    assert used == [False, False, True, True, False, True]
