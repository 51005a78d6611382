# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Channels that a device reads one after another: each is brought to the tick at its own time, or stated as unknown.

A joint turns at 1 rad/s in a sawtooth behind the server of each multiplexing device. No noise is simulated, so an error
of a third of the standard uncertainty would make the errors of noisy scans 5 % larger. A stamp that is late turns the
pose about its axis, which multiplexing does not: it displaces it.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from posor import Fault, Posor, State, load_calibration, simulate
from posor.arm_names import find_arm
from posor.calibration.design_parts import quantity_entry
from posor.messages.message_definitions import MessageTypes
from posor.messages.raw_scan import scan_of
from posor.model.scan import Scan, Scans
from posor.numerics.array_types import FloatArray
from posor_drivers.instruments.channel_exposures import ExposureEntry, find_exposures
from posor_drivers.instruments.device import DeviceError, Frames
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.nidaqmx_device import NiDevice, NiSettings
from posor_drivers.instruments.stream_device import StreamDevice, StreamSettings
from posor_drivers.sources.instrument_source import InstrumentParameters, InstrumentSource
from posor_lab.device_servers.labjack_server import LabJackServer, LabJackStreamServer
from posor_lab.device_servers.scpi_server import FIRST_CHANNEL, ScpiServer
from posor_lab.harness.program import wait_until
from pydantic import ValidationError

from .stream_rig import write_rig

INTERVAL_S, RATE, SAWTOOTH_NS = 20e-6, 1.0, 50_000_000  # from channel to channel, [rad/s], period of the sawtooth
GAPS, CHANNELS, FEEDBACK_OHM = 3, 11, 1e5
COUNT, TABLE = 60, 2001
ADDED = 0.32  # share of the standard uncertainty that adds 5 %
ATTEMPTS = 5


def theta(time_ns: int) -> float:
    return RATE * 1e-9 * (time_ns % SAWTOOTH_NS - SAWTOOTH_NS // 2)


@cache
def posor() -> Posor:
    return Posor(load_calibration(find_arm("test_rig").parent / "calibrations" / "joint1.yaml"))


@cache
def table() -> FloatArray:
    """Return the voltages of the channels at theta from one end of the sawtooth to the other, (TABLE, CHANNELS)."""
    thetas = np.linspace(theta(0), -theta(0), TABLE)
    poses = np.zeros((TABLE, 7))
    poses[:, 2], poses[:, 5], poses[:, 6] = 0.735e-3, np.sin(0.5 * thetas), np.cos(0.5 * thetas)
    scans = simulate(posor().calibration, poses)
    return np.hstack([scans.gap_voltages, FEEDBACK_OHM * scans.diode_currents.reshape(TABLE, -1)])


def voltages(time_ns: int) -> list[float]:
    row, share = divmod((TABLE - 1) * (time_ns % SAWTOOTH_NS) / SAWTOOTH_NS, 1.0)
    before, after = table()[int(row)], table()[int(row) + 1]
    found: list[float] = (before + share * (after - before)).tolist()
    return found


def device_of(kind: str, server: Any, statement: str) -> dict[str, Any]:
    """Return the device of an instruments file; ``statement``: on its exposures, empty: those of its settings."""
    names, override = [f"c{n}" for n in range(CHANNELS)], {"exposures": statement} if statement else {}
    if kind == "scpi":
        channels = {name: {"number": FIRST_CHANNEL + n, "unit": "V"} for n, name in enumerate(names)}
        device: dict[str, Any] = {"address": f"TCPIP::127.0.0.1::{server.port}::SOCKET", "dialect": "keysight_daq970a"}
        times = {"channel_delay": quantity_entry(5e-6, "s"), "aperture": quantity_entry(15e-6, "s")}
        return {**device, "channels": channels, "rate": quantity_entry(200, "Hz"), **times, **override}
    channels = {name: {"input": n, "range": quantity_entry(10.0, "V")} for n, name in enumerate(names)}
    device = {"host": "127.0.0.1", "port": server.port, "channels": channels, "rate": quantity_entry(250, "Hz")}
    if kind == "labjack_stream":
        stream = {
            "stream_port": server.stream_port,
            "rate": quantity_entry(1000, "Hz"),
            "settling": quantity_entry(17e-6, "s"),
        }
        return device | stream | override
    return device | {"exposures": statement or {"interval": quantity_entry(INTERVAL_S, "s")}}


def new_server(kind: str) -> Any:
    servers: dict[str, Any] = {"scpi": ScpiServer, "labjack_stream": LabJackStreamServer}
    return LabJackServer(voltages, INTERVAL_S) if kind == "labjack" else servers[kind](voltages)


@contextmanager
def source_of(folder: Path, kind: str, device: dict[str, Any]) -> Iterator[InstrumentSource]:
    currents = [
        {"channel": f"daq/c{n}", "scale": quantity_entry(1.0 / FEEDBACK_OHM, "A/V")} for n in range(GAPS, CHANNELS)
    ]
    joint = {"gap_voltages": [{"channel": f"daq/c{n}"} for n in range(GAPS)], "diode_currents": currents}
    joint |= {"frame_id": "receiving", "lit_sources": [0, 1]}
    content = {"format": "posor_instruments", "version": 1, "name": "rig", "rate": quantity_entry(500, "Hz")}
    content |= {
        "latency": quantity_entry(0.05, "s"),
        "devices": {"daq": {"kind": kind, **device}},
        "joints": {"joint1": joint},
    }
    source = InstrumentSource(InstrumentParameters(file=write_rig(folder, content), joint="joint1"), MessageTypes())
    try:
        source.open()
        yield source
    finally:
        source.close()


def scans_of(source: InstrumentSource) -> list[Scan]:
    """Return scans from the middle of the sawtooth, away from its jumps."""
    scans: dict[int, Scan] = {}

    def read() -> bool:
        for message in source.read_tick(source.newest_tick(time.time_ns())):
            if abs(message.time_ns % SAWTOOTH_NS - SAWTOOTH_NS // 2) < SAWTOOTH_NS // 10:
                scans[message.time_ns] = scan_of(message.data)
        return len(scans) >= COUNT

    wait_until(read, "scans", lambda: time.sleep(0.001))
    return list(scans.values())


@pytest.mark.parametrize("kind", ["scpi", "labjack", "labjack_stream"])
def test_multiplexing_adds_less_than_5_percent_to_the_errors_or_is_said_to_be_unknown(
    tmp_path: Path, kind: str
) -> None:
    added, estimates = {"": math.inf}, {}
    # The stamps of a loaded host scatter, which adds errors that are not of multiplexing: another attempt is allowed.
    for statement in (*[""] * ATTEMPTS, "unknown", "simultaneous"):
        if not statement and added[""] < ADDED:
            continue
        with new_server(kind) as server, source_of(tmp_path, kind, device_of(kind, server, statement)) as source:
            scans = Scans.of(scans_of(source)[:COUNT])
        assert 0.0 < np.median(scans.stamp_uncertainties) < 5e-3
        assert np.all(scans.stamp_limits >= scans.stamp_uncertainties)
        assert np.isnan(scans.exposure_offsets).sum() == (CHANNELS * COUNT if statement == "unknown" else 0)
        found = posor().estimate_each(scans.with_fields({"stamp_uncertainties": np.zeros(COUNT)}))
        sigmas = np.sqrt(np.diagonal(found.covariances_random, axis1=1, axis2=2)[:, :3])
        added[statement] = np.nanmedian(np.abs(found.translations - [0.0, 0.0, 0.735e-3]) / sigmas, axis=0).max()
        estimates[statement] = found
    assert np.mean(estimates[""].states == State.OK) > 0.8  # a loaded host answers late now and then
    assert added[""] < ADDED < 1.0 < added["simultaneous"]
    assert State.OK not in estimates["unknown"].states
    assert np.bitwise_or.reduce(estimates["unknown"].faults) & Fault.TIME


NAN = math.nan


@pytest.mark.parametrize(
    ("order", "interval_s", "entry", "offsets_s", "span_s"),
    [
        ((0, 1, 2), 0.0, None, (0.0, 0.0, 0.0), 0.0),
        ((2, 0, 1), 2e-5, None, (2e-5, -2e-5, 0.0), 4e-5),
        ((0, 1, 2), NAN, None, (NAN, NAN, NAN), 1e-3),
        ((0, 0, 0), NAN, None, (0.0, 0.0, 0.0), 0.0),  # one input alone
        ((0, 1, 2), 2e-5, "simultaneous", (0.0, 0.0, 0.0), 0.0),
        ((0, 1, 2), 2e-5, "unknown", (NAN, NAN, NAN), 1e-3),
        ((0, 1, 2), NAN, {"interval": quantity_entry(1e-5, "s")}, (-1e-5, 0.0, 1e-5), 2e-5),
        ((0, 1, 2), 2e-5, {"offsets": {"b": quantity_entry(7e-5, "s")}}, (-2e-5, 7e-5, 2e-5), 9e-5),
        ((0, 1, 2), 2e-5, {"offsets": {"c": "unknown"}}, (-2e-5, 0.0, NAN), 1e-3),
    ],
)
def test_exposures_by_settings_and_statements(
    order: tuple[int, ...], interval_s: float, entry: Any, offsets_s: tuple[float, ...], span_s: float
) -> None:
    stated: Any = entry if entry is None or isinstance(entry, str) else ExposureEntry.model_validate(entry)
    found = find_exposures("abc", order, interval_s, 1e-3, stated)
    np.testing.assert_allclose(found.offsets_s, offsets_s, atol=1e-18)
    assert found.span_s == pytest.approx(span_s)


def stream_device(**changes: Any) -> StreamDevice:
    channels = {name: {"unit": "V"} for name in "ab"}
    frames = {"transport": "tcp", "host": "127.0.0.1", "port": 1, "format": "<Idd", "fields": ["counter", *"ab"]}
    content = {"kind": "stream", "rate": quantity_entry(1000, "Hz"), **frames, "channels": channels, **changes}
    return StreamDevice("box", StreamSettings.model_validate(content))


def test_the_first_channel_of_a_triggered_frame_is_read_at_the_tick() -> None:
    entry = {"exposures": {"interval": quantity_entry(1e-4, "s")}, "trigger_tolerance": quantity_entry(2e-4, "s")}
    reader = DeviceReader(stream_device(**entry))
    assert reader.exposures.offsets_s == pytest.approx((0.0, 1e-4))
    numbers = np.arange(3)
    frames = Frames(
        numbers, np.tile(numbers, (2, 1)).T.astype(float), 50_000 + 1_000_000 * numbers
    )  # middle of a frame
    reader._store(frames, 0)
    np.testing.assert_array_equal(reader.values_at(1_000_000), [1.0, 1.0])
    error = reader.stamp_error_at(1_000_000)
    assert error is not None
    assert error.limit_s == pytest.approx(2e-4)


def test_the_uncertainty_of_the_least_delay_is_part_of_the_error_of_the_stamps() -> None:
    reader = DeviceReader(stream_device(delay=quantity_entry(2e-4, "s", 3e-5)))
    assert reader.stamp_error_at(0) is None
    for first, uncertainty_s in ((0, 4e-5), (3, 7e-5)):  # of the newest frames it is larger
        numbers = first + np.arange(3)
        reader._store(Frames(numbers, np.zeros((3, 2)), 1_000_000 * numbers, uncertainty_s), 0)
    assert reader.stamp_error_at(800_000) == pytest.approx((5e-5, math.sqrt(3.0) * (5.0 / 3.0 * 4e-5 + 3e-5)))


@pytest.mark.parametrize("entry", [{}, "sometimes", {"interval": quantity_entry(-1.0, "s")}])
def test_an_invalid_statement_is_refused(entry: Any) -> None:
    with pytest.raises(ValidationError):
        stream_device(exposures=entry)
    with pytest.raises(DeviceError, match="box: an exposure of channel 'c'; expected one of a, b"):
        DeviceReader(stream_device(exposures={"offsets": {"c": "unknown"}}))


@pytest.mark.parametrize(
    ("devices", "convert_hz", "interval_s"),
    [([False], None, 1e-5), ([False], 2e4, 5e-5), ([True, True], None, 0.0), ([False, False], None, NAN)],
)
def test_a_task_of_ni_states_its_convert_clock(
    monkeypatch: pytest.MonkeyPatch, devices: list[bool], convert_hz: float | None, interval_s: float
) -> None:
    timing = SimpleNamespace(ai_conv_rate=1e5, cfg_samp_clk_timing=lambda *_, **__: None)
    task = SimpleNamespace(
        timing=timing,
        start=lambda: None,
        ai_channels=SimpleNamespace(add_ai_voltage_chan=lambda *_, **__: None),
        devices=[SimpleNamespace(ai_simultaneous_sampling_supported=each) for each in devices],
    )
    package, errors = ModuleType("nidaqmx"), ModuleType("nidaqmx.errors")
    constants = SimpleNamespace(AcquisitionType=SimpleNamespace(CONTINUOUS=1))
    vars(package).update(Task=lambda: task, constants=constants)
    vars(errors).update(DaqError=OSError, DaqNotFoundError=OSError)
    monkeypatch.setitem(sys.modules, "nidaqmx", package)
    monkeypatch.setitem(sys.modules, "nidaqmx.errors", errors)
    settings = {"kind": "nidaqmx", **NiDevice.starting_settings({"a": "V", "b": "V"})}
    settings |= {} if convert_hz is None else {"convert_rate": quantity_entry(convert_hz, "Hz")}
    device = NiDevice("daq", NiSettings.model_validate(settings))
    assert np.isnan(device.exposures.offsets_s).all()
    device.connect(1.0)
    np.testing.assert_allclose(device.exposures.offsets_s, [-0.5 * interval_s, 0.5 * interval_s])
