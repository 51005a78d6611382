# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``instruments`` and the instruments file, with a device over a real socket."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
from posor.calibration.design_parts import quantity_entry
from posor_drivers.instruments.instruments_command import main
from posor_lab.device_servers.stream_server import StreamServer

from .stream_rig import stream_rig, write_rig


def content(port: int) -> dict[str, Any]:
    gap = {"channel": "box/gap1", "scale": quantity_entry(1e4, "V/m")}
    return stream_rig(port, {"gap1": "m", "plate": "degC"}, {"gap_voltages": [gap]}, rate_hz=500, latency_s=0.02)


def test_a_latency_beyond_the_frames_that_are_kept_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = content(1)
    file["latency"]["value"], file["devices"]["box"]["rate"]["value"] = 2, 4000
    assert main(["list", write_rig(tmp_path, file)]) == 1
    sentence = "key latency.value: 2 s, 8000 frames of device 'box'; expected at most 7372 frames."
    assert sentence in capsys.readouterr().err


def test_devices_are_listed_without_a_connection(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = content(1)
    file["devices"]["box"]["exposures"] = {"offsets": {"gap1": quantity_entry(2e-5, "s"), "plate": "unknown"}}
    assert main(["list", write_rig(tmp_path, file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:] == [
        "box: stream at tcp 127.0.0.1:1, 500 frames per second",
        "  gap1 [m]: elbow gap_voltages[0]; read +20 us from its frame",
        "  plate [degC]: not used; read at an unknown time",
    ]


def test_probe_prints_rate_and_values(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with StreamServer(lambda _: (2.5e-4, 21.5), 500.0) as server:
        assert main(["probe", write_rig(tmp_path, content(server.port))]) == 0
        first, second = capsys.readouterr().out.splitlines()
        found = re.match(rf"box: tcp 127.0.0.1:{server.port}; ([\d.]+) frames per second, stamps within", first)
        assert found
        assert abs(float(found[1]) - 500.0) < 1.0
        assert second == "  gap1 0.00025 m, plate 21.5 degC"


def test_probe_of_an_absent_device_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posor_drivers.instruments.instruments_command.PROBE_S", 0.5)
    with StreamServer(lambda _: (0.0, 0.0)) as server:
        port = server.port
    assert main(["probe", write_rig(tmp_path, content(port))]) == 1
    printed = capsys.readouterr()
    assert printed.out == "box: FAULT\n"
    assert printed.err.startswith(f"instruments probe: box: no connection to 127.0.0.1:{port}")


def test_probe_names_the_fault_that_closed_the_connection_while_it_is_open_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posor_drivers.instruments.instruments_command.PROBE_S", 2.0)
    with StreamServer(lambda _: (0.0, 0.0), 500.0) as server:
        file = content(server.port)
        file["devices"]["box"]["rate"] = quantity_entry(250.0, "Hz")
        assert main(["probe", write_rig(tmp_path, file)]) == 1
    assert re.search(r"box: [\d.]+ frames per second; expected 250, as stated\.$", capsys.readouterr().err.strip())


ELBOW = "joints.elbow"
GAP = "joints.elbow.gap_voltages.0"


@pytest.mark.parametrize(
    ("place", "change", "sentence"),
    [
        (GAP, {"channel": "box/gap2"}, "channel 'box/gap2'; expected one of box/gap1, box/plate."),
        (GAP, {"scale": None}, "channel 'box/gap1' is in m; expected a scale in V/m."),
        (f"{GAP}.scale", {"unit": "V/mm"}, "scale in V/mm; expected one number in V/m."),
        (ELBOW, {"lit_sources": [0]}, "0 diode currents and 1 lit sources; expected one source for the four currents"),
        (ELBOW, {"home_mark": {"channel": "box/gap1"}}, "channel 'box/gap1' is in m; expected a channel of unit 1."),
        (
            ELBOW,
            {"home_mark": {"channel": "box/gap1", "offset": quantity_entry(1, "m")}},
            "a scale or offset of a whole number; expected only a channel of unit 1.",
        ),
        (ELBOW, {"gap_voltages": []}, "no reading; expected at least one of"),
        (
            ELBOW,
            {"gap_voltages": [{"channel": "box/gap1", "scale": quantity_entry(1, "V/m")}] * 2},
            "gap_voltages[1].channel: channel 'box/gap1' is used twice, also as elbow.gap_voltages[0]; expected a chan",
        ),
        (GAP, {"channel": "box.gap1"}, "channel 'box.gap1'; expected DEVICE/CHANNEL."),
        (f"{GAP}.scale", {"value": 0}, "scale.value: scale 0; expected a number other than 0."),
        ("devices.box.channels.gap1", {"scale": 0.0}, "channels.gap1.scale: scale 0; expected a number other than 0."),
        ("devices.box.channels.gap1", {"scale": math.inf}, "channels.gap1.scale: inf; expected a finite number."),
        *(
            ("devices.box", {"host": host}, f"host '{host}'; expected a host name or an IP address, without a port.")
            for host in ("", "http://box", "192.168.0.500", "192.168.0.5:5000", "a b", "fe80::x")
        ),
        ("devices.box", {"kind": "strean"}, "kind 'strean'; expected "),
        ("devices.box", {"rate": 500}, "500 has no unit; expected a mapping such as"),
        ("latency", {"value": 50}, "latency.value: 50.0 s; expected 0 to 5 s (milliseconds?)."),
        ("devices.box", {"delay": quantity_entry(20, "s")}, "delay.value: 20.0 s; expected 0 to 5 s (milliseconds?)."),
        ("rate", {"value": 0.5}, "0.5 Hz; expected a whole number from 1 to 10000."),
    ],
)
def test_invalid_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str, change: dict[str, Any], sentence: str
) -> None:
    file = content(1)
    entry: Any = file
    for key in place.split("."):
        entry = entry[int(key) if key.isdigit() else key]
    entry |= change
    assert main(["list", write_rig(tmp_path, file)]) == 1
    error = capsys.readouterr().err
    assert sentence in error
    assert re.match(r".*instruments\.yaml, line \d+, key ", error)
