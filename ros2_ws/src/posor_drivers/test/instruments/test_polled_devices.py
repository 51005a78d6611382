# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Devices ``labjack`` and ``scpi`` over real sockets, against servers of other code bases."""

from __future__ import annotations

import socketserver
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from posor.calibration.design_parts import quantity_entry
from posor.errors import CalibrationError
from posor.messages.message_definitions import MessageTypes
from posor_drivers.instruments.device import DeviceError, Frames
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.labjack_device import LabJackDevice, LabJackSettings
from posor_drivers.instruments.scpi_device import ScpiDevice, ScpiSettings
from posor_drivers.sources.instrument_source import InstrumentParameters, InstrumentSource
from posor_lab.device_servers.labjack_server import LabJackServer
from posor_lab.device_servers.scpi_server import ScpiServer
from posor_msgs.msg import RawScan
from pydantic import ValidationError
from rclpy.serialization import deserialize_message

from .device_states import running, wait_for, wait_for_fault, wait_for_frames, wait_for_reported_fault
from .stream_rig import stream_rig, write_rig

OVERLOAD = 9.9e37


def ramp(time_ns: int) -> list[float]:
    """Voltages that grow by 0.01, 0.02, ... per second."""
    seconds = (time_ns % 100_000_000_000) * 1e-9
    return [0.01 * n * seconds for n in range(1, 9)]


def labjack_settings(port: int, **changes: Any) -> LabJackSettings:
    content = {
        "kind": "labjack",
        "host": "127.0.0.1",
        "port": port,
        "rate": {"value": 200, "unit": "Hz"},
        "channels": {
            "far": {"input": 5, "range": {"value": 10, "unit": "V"}},
            "first": {"input": 0, "range": {"value": 0.1, "unit": "V"}, "negative_input": 1, "resolution_index": 2},
            "second": {"input": 1},
        },
    }
    return LabJackSettings.model_validate(content | changes)


def scpi_settings(port: int, **changes: Any) -> ScpiSettings:
    content = {
        "kind": "scpi",
        "address": f"TCPIP::127.0.0.1::{port}::SOCKET",
        "dialect": "keysight_daq970a",
        "rate": {"value": 20, "unit": "Hz"},
        "channels": {"gap2": {"number": 103, "unit": "V"}, "gap1": {"number": 101, "unit": "V"}},
    }
    return ScpiSettings.model_validate(content | changes)


@pytest.fixture
def labjack() -> Iterator[LabJackServer]:
    with LabJackServer(ramp) as server:
        yield server


@pytest.fixture
def scanner() -> Iterator[ScpiServer]:
    with ScpiServer(ramp) as server:
        yield server


@pytest.fixture(params=["labjack", "scpi"])
def server(request: pytest.FixtureRequest) -> Any:
    return request.getfixturevalue("labjack" if request.param == "labjack" else "scanner")


@pytest.fixture
def reader(server: LabJackServer | ScpiServer) -> Iterator[DeviceReader]:
    is_labjack, port = isinstance(server, LabJackServer), server.port
    device = LabJackDevice("box", labjack_settings(port)) if is_labjack else ScpiDevice("box", scpi_settings(port))
    with running(device) as reader:
        yield reader


def test_values_are_those_of_their_time(server: LabJackServer | ScpiServer, reader: DeviceReader) -> None:
    wait_for_frames(reader)
    errors = []

    def take() -> bool:
        at_ns = time.time_ns() - 200_000_000
        if (values := reader.values_at(at_ns)) is not None:
            expected = ramp(at_ns)
            numbers = (5, 0, 1) if isinstance(server, LabJackServer) else (2, 0)
            late_s = (values - np.array(expected)[[*numbers]]) / (0.01 * (np.array(numbers) + 1))
            errors.append(np.nanmax(np.abs(late_s)))  # NaN: out of range
        return len(errors) >= 20

    wait_for(take, "20 values")
    assert np.median(errors) < 5e-3  # a loaded host answers late now and then
    values = reader.state.values
    assert 0.0 < values["clock_uncertainty"] < 0.1
    assert values["frames"] > 0


@pytest.mark.parametrize("step_s", [0.0, 0.05, -0.05, -0.001])
def test_a_clock_that_is_set_between_question_and_answer_is_in_the_uncertainty(
    monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    set_ns, read_ns = [0], []

    def time_ns() -> int:
        read_ns.append(time.time_ns() + set_ns[0])
        return read_ns[-1]

    with LabJackServer(ramp) as server:
        device = LabJackDevice("box", labjack_settings(server.port))
        device.connect(1.0)
        ask = device.ask

        def ask_and_set() -> Any:
            set_ns[0] = round(1e9 * step_s)
            return ask()

        monkeypatch.setattr(device, "ask", ask_and_set)
        clock = SimpleNamespace(time_ns=time_ns, monotonic=time.monotonic, sleep=time.sleep)
        monkeypatch.setattr("posor_drivers.instruments.polled_device.time", clock)
        frames = device.read(1.0)
        device.close()
    assert frames is not None
    assert frames.times_ns is not None
    asked_ns, answered_ns = read_ns[0] + set_ns[0], read_ns[-1]  # by the clock after the step
    errors_s = np.abs(np.array([asked_ns, answered_ns]) - frames.times_ns) * 1e-9
    assert errors_s.max() <= np.sqrt(3.0) * frames.time_uncertainty_s + 20e-6  # of two readings of clocks
    assert frames.time_uncertainty_s < 0.5 * abs(step_s) + 0.05


def test_frames_of_a_clock_that_was_set_back_are_not_interpolated(monkeypatch: pytest.MonkeyPatch) -> None:
    times_s = [1.0, 1.1, 1.2, 1.3, 0.75, 0.85, 0.95]
    with LabJackServer(ramp) as server:
        device = LabJackDevice("box", labjack_settings(server.port, rate={"value": 10, "unit": "Hz"}))
        with running(device) as reader:
            wait_for_frames(reader)
            start_ns, taken = time.time_ns(), iter(enumerate(times_s, start=1000))

            def read(_: float) -> Frames | None:
                number, time_s = next(taken, (0, 0.0))
                ns = np.array([start_ns + round(1e9 * time_s)])
                return Frames(np.array([number]), np.full((1, 3), time_s), ns) if number else None

            monkeypatch.setattr(device, "read", read)
            wait_for(lambda: (reader.newest_frame() or (0,))[0] == 1000 + len(times_s) - 1, "frames")
            found = [reader.values_at(start_ns + round(1e9 * time_s)) for time_s in (0.77, 0.86, 1.16)]
    assert found[0] is None
    assert found[1] is not None
    np.testing.assert_allclose(found[1], 0.86, atol=1e-9)


def test_a_stall_and_a_restart_of_the_device_are_named_and_end(
    server: LabJackServer | ScpiServer, reader: DeviceReader
) -> None:
    wait_for_frames(reader)
    server.stalled.set()
    wait_for_reported_fault(reader, "expected an answer in time")
    assert reader.values_at(time.time_ns() - 1_000_000) is None
    server.stalled.clear()
    wait_for_frames(reader)
    server.stop()
    wait_for_fault(reader)
    wait_for_reported_fault(
        reader, "box: no connection to " if isinstance(server, LabJackServer) else "Connection refused"
    )
    server.start()
    wait_for_frames(reader)


def test_inputs_of_a_labjack_are_set_up_and_a_value_beyond_its_range_is_invalid(labjack: LabJackServer) -> None:
    labjack.registers.voltages = lambda _time_ns: [0.25, -0.5, 0.0, 0.0, 0.0, 10.5]
    with running(LabJackDevice("box", labjack_settings(labjack.port))) as reader:
        wait_for_frames(reader)
        assert reader.state.text == "LabJack T7, firmware 1.0292"
        np.testing.assert_array_equal(reader.newest_values(), [np.nan, np.nan, -0.5])
    assert labjack.written_float(40_010) == 10.0
    assert labjack.written_float(40_000) == pytest.approx(0.1)
    assert labjack.registers.written[41_000] == 1
    assert labjack.registers.written[41_500] == 2
    assert 40_002 not in labjack.registers.written


def test_the_mark_of_an_invalid_value_is_no_voltage(labjack: LabJackServer) -> None:
    labjack.registers.voltages = lambda _time_ns: [-9999.0, 10.5]
    channels = {"a": {"input": 0}, "b": {"input": 1}}
    with running(LabJackDevice("box", labjack_settings(labjack.port, channels=channels))) as reader:
        wait_for_frames(reader)
        np.testing.assert_array_equal(reader.newest_values(), [np.nan, 10.5])


@pytest.mark.parametrize(
    ("product", "inputs", "interval_s"), [(8.0, (0, 1), 0.0), (8.0, (0, 1, 5), np.nan), (7.0, (0, 1), np.nan)]
)
def test_only_the_inputs_of_one_question_to_a_t8_are_simultaneous(
    product: float, inputs: tuple[int, ...], interval_s: float
) -> None:
    channels = {f"c{n}": {"input": n} for n in inputs}
    with LabJackServer(ramp) as server:
        server.registers.product = product
        device = LabJackDevice("box", labjack_settings(server.port, channels=channels))
        device.connect(1.0)
        device.close()
    np.testing.assert_array_equal(device.channel_interval_s, interval_s)


def test_another_product_and_an_input_that_does_not_exist_are_refused(labjack: LabJackServer) -> None:
    channels = {"none": {"input": 60}}
    with running(LabJackDevice("box", labjack_settings(labjack.port, channels=channels))) as reader:
        sentence = "Modbus exception 2 for register 120; expected registers of a LabJack; the input may not exist."
        wait_for_reported_fault(reader, f"box: {sentence}")
        labjack.registers.product = 6.0
        wait_for_reported_fault(
            reader, "box: the product is 6; expected 4 (LabJack T4), 7 (LabJack T7), 8 (LabJack T8)."
        )


def test_neighbouring_inputs_are_one_question() -> None:
    def questions(*inputs: int) -> list[tuple[int, int]]:
        channels = {f"c{n}": {"input": n} for n in inputs}
        return LabJackDevice("box", labjack_settings(502, channels=channels))._questions

    assert questions(3, 1, 2, 9) == [(1, 3), (9, 1)]
    assert questions(*range(70)) == [(0, 62), (62, 8)]


def test_faults_of_a_scanner_are_named(scanner: ScpiServer) -> None:
    with running(ScpiDevice("meter", scpi_settings(scanner.port))) as reader:
        wait_for_frames(reader)
        assert scanner.scanned == [101, 103]
        assert reader.state.text == "Keysight Technologies,DAQ970A,MY12345678,A.02.04"
        scanner.errors = [(-222, "Data out of range"), *[(-410, "Query INTERRUPTED")] * 3]
        texts = '-222,"Data out of range"; -410,"Query INTERRUPTED" (3 times)'
        wait_for_reported_fault(reader, f"meter: the instrument reports {texts}; expected an empty error queue.")
        wait_for_frames(reader)
        scanner.answer = "1.0,2.0,3.0"
        wait_for_reported_fault(
            reader, "meter: the answer to 'READ?' is '1.0,2.0,3.0'; expected 2 numbers, separated by ','."
        )
        scanner.answer = "1_0,2.0"  # a number for Python alone
        wait_for_reported_fault(reader, "meter: the answer to 'READ?' is '1_0,2.0'")
        scanner.answer = f"1.5,{OVERLOAD:E}"
        wait_for_frames(reader)
        np.testing.assert_array_equal(reader.newest_values(), [np.nan, 1.5])
        scanner.answer, scanner.model = "no number", "34401A"
        wait_for_reported_fault(reader, "expected a model that matches 'DAQ97[03]A'.")


def test_an_unsolicited_line_is_named_before_it_is_taken_for_an_answer(scanner: ScpiServer) -> None:
    meter = ScpiDevice("meter", scpi_settings(scanner.port))
    meter.connect(5.0)
    scanner.answer = "1.0,2.0\n3.0,4.0"
    sentence = r"the instrument sent the unsolicited line '3\.0,4\.0'; expected one line"
    with pytest.raises(DeviceError, match=sentence):  # which of the two lines is the answer?
        meter.read(1.0)
    meter.close()
    meter.connect(5.0)
    assert meter.ask() == [2.0, 1.0]
    with pytest.raises(DeviceError, match=sentence):
        meter.read(1.0)
    meter.close()


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        ("READ?\n1.0,2.0", r"the instrument echoes 'READ\?'; expected answers without the question"),
        ("1.0\n2.0,3.0", r"the answers to '\*IDN\?' are '.*' and then '2\.0,3\.0'; expected one line for each query"),
    ],
    ids=["echo", "two lines"],
)
def test_a_line_before_the_answer_is_no_error_of_the_instrument(
    scanner: ScpiServer, answer: str, sentence: str
) -> None:
    scanner.answer = answer
    with closing(ScpiDevice("meter", scpi_settings(scanner.port))) as meter:
        meter.connect(5.0)
        with pytest.raises(DeviceError, match=sentence):
            meter.read(1.0)


IDENTITY = "Keysight Technologies,DAQ970A,MY12345678,A.02.04"


@contextmanager
def greeting(line: str, *, echo: bool = False) -> Iterator[int]:
    """Send a line to each client before the answers to its questions; yield the port."""

    class Meter(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            self.wfile.write(line.encode())
            with suppress(OSError):
                for received in self.rfile:
                    question = received.decode().strip()
                    answers = [question] if echo else []
                    if question.endswith("?"):
                        answers.append({"*IDN?": IDENTITY, "FUNC?": '"VOLT"'}.get(question, '+0,"No error"'))
                    self.wfile.write("".join(f"{each}\n" for each in answers).encode())

    class Server(socketserver.ThreadingTCPServer):
        allow_reuse_address = daemon_threads = True

    with Server(("127.0.0.1", 0), Meter) as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize("line", ["Welcome to Keysight DAQ970A", IDENTITY])
@pytest.mark.parametrize("dialect", ["keysight_daq970a", "single_meter"])
def test_a_greeting_is_never_taken_for_an_answer(line: str, dialect: str) -> None:
    channels = {"gap": {"number": 101, "unit": "V"}}
    with greeting(f"{line}\r\n") as port:
        meter = ScpiDevice("meter", scpi_settings(port, dialect=dialect, channels=channels))
        with closing(meter), pytest.raises(DeviceError) as caught:
            meter.connect(1.0)
    assert caught.value.expected == "one line for each query"


def test_an_echo_is_named_when_the_driver_connects() -> None:
    with greeting("", echo=True) as port, closing(ScpiDevice("meter", scpi_settings(port))) as meter:
        with pytest.raises(DeviceError) as caught:
            meter.connect(1.0)
        assert caught.value.expected == "answers without the question"


def test_settings_that_another_user_changes_are_named(scanner: ScpiServer, labjack: LabJackServer) -> None:
    with running(ScpiDevice("meter", scpi_settings(scanner.port))) as reader:
        wait_for_frames(reader)
        scanner.functions[103] = "RES"
        answer = 'the answer to \'CONF? (@101,103)\' has changed from "VOLT:DC","VOLT:DC" to "VOLT:DC","RES"'
        wait_for_reported_fault(
            reader, f"meter: {answer}; expected nobody else who sets up the device while the driver runs."
        )
        wait_for_frames(reader)  # of the next connection, which sets the function up
        assert scanner.functions == {101: "VOLT:DC", 103: "VOLT:DC"}
    with running(LabJackDevice("box", labjack_settings(labjack.port))) as reader:
        wait_for_frames(reader)
        labjack.registers.written[41_000] = 199
        wait_for_reported_fault(
            reader, "box: negative_input of input 0 has changed from 1 to 199; expected nobody else"
        )
        wait_for_frames(reader)
        labjack.registers.written[40_000 + 2 * 5] = 0
        wait_for_reported_fault(reader, "box: range of input 5 has changed from 10.0 to ")


LIGHT = {"output": 204, "interval": {"value": 0.5, "unit": "s"}}


def test_a_scanner_switches_the_light_sources_and_states_it(scanner: ScpiServer, tmp_path: Path) -> None:
    channels = {f"c{n}": {"number": 101 + n, "unit": "V"} for n in range(4)}
    device = scpi_settings(scanner.port, channels=channels, light=LIGHT, rate={"value": 50, "unit": "Hz"})
    joint = {
        "diode_currents": [{"channel": f"meter/c{n}", "scale": quantity_entry(1e-5, "A/V")} for n in range(4)],
        "lit_sources": [3],
        "light": {"channel": "meter/light"},
        "demodulated": False,
    }
    file = write_rig(tmp_path, stream_rig(1, {}, joint) | {"devices": {"meter": device.model_dump(mode="json")}})
    source = InstrumentSource(InstrumentParameters(file=file, joint="elbow"), MessageTypes())
    seen: list[int] = []
    try:
        source.open()

        def both() -> bool:
            for message in source.read_tick(source.newest_tick(time.time_ns() - 40_000_000)):
                (lit,) = deserialize_message(message.data, RawScan).lit_sources
                seen.append(lit) if seen[-1:] != [lit] else None
            return len(seen) >= 4

        wait_for(both, "two changes between lit and dark")
    finally:
        source.close()
    assert set(pairwise(seen)) == {(3, 255), (255, 3)}
    assert scanner.outputs[:3] == [(0, 204), (1, 204), (0, 204)]


def test_only_one_process_switches_a_light(scanner: ScpiServer) -> None:
    settings = scpi_settings(scanner.port, light=LIGHT)
    first, second = ScpiDevice("meter", settings), ScpiDevice("meter", settings)
    first.connect(5.0)
    with pytest.raises(DeviceError, match="meter: another driver switches the light, output 204 of TCPIP"):
        second.connect(5.0)
    second.close()
    first.close()
    assert len(scanner.outputs) == 1
    second.connect(5.0)
    second.close()


def test_invalid_settings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="dialect 'none'"):
        scpi_settings(5025, dialect="none")
    with pytest.raises(ValidationError, match="number 101, used twice"):
        scpi_settings(5025, channels={name: {"number": 101, "unit": "V"} for name in "ab"})
    with pytest.raises(ValidationError):
        labjack_settings(502, channels={"a": {"input": -1}})
    own = tmp_path / "own.yaml"
    own.write_text("format: posor_scpi_dialect\nversion: 2\nidentify: ID?\nmodel: '('\n", encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"own\.yaml"):
        ScpiDevice("meter", scpi_settings(5025, dialect=str(own)))
    with pytest.raises(ValidationError, match="channel 'light'"):
        scpi_settings(5025, light=LIGHT, channels={"light": {"number": 101, "unit": "V"}})
    with pytest.raises(DeviceError, match="dialect 'single_meter' has no command 'digital_output'"):
        ScpiDevice("meter", scpi_settings(5025, dialect="single_meter", light=LIGHT))
    with pytest.raises(DeviceError, match="dialect 'single_meter' has no command 'aperture'"):
        ScpiDevice("meter", scpi_settings(5025, dialect="single_meter", aperture={"value": 0.1, "unit": "s"}))


CHANNEL = {"number": 102, "unit": "degC"}


@pytest.mark.parametrize(
    ("dialect", "channel", "sentence"),
    [
        ("keysight_daq970a", {"unit": "K"}, "unit 'K' of channel 'c'; expected one of V, Ohm, degC, which dialect 'ke"),
        ("single_meter", {}, "unit 'degC' of channel 'c'; expected one of V, A, Ohm, which dialect 'single_meter' se"),
        ("keysight_34980a", {}, "channel 'c' of unit 'degC' has no key 'function'; expected one of thermocouple_k, pt"),
        ("keysight_daq970a", {"function": "voltage"}, "channel 'c', whose function is voltage; expected unit 'V'"),
        ("keysight_daq970a", {"unit": "mV", "function": "voltage"}, "unit 'mV' of channel 'c', whose function is vol"),
        ("keysight_daq970a", {"function": "ac"}, "function 'ac' of channel 'c'; expected one of voltage, resistance"),
    ],
)
def test_a_unit_that_the_set_up_does_not_give_is_refused(dialect: str, channel: dict[str, str], sentence: str) -> None:
    with pytest.raises(DeviceError, match=sentence):
        ScpiDevice("meter", scpi_settings(5025, dialect=dialect, channels={"c": CHANNEL | channel}))


def test_each_channel_is_set_up_for_its_unit(scanner: ScpiServer) -> None:
    channels = {"gap": {"number": 103, "unit": "V"}, "plate": CHANNEL | {"function": "pt100"}}
    device = ScpiDevice("meter", scpi_settings(scanner.port, channels=channels, aperture={"value": 0.01, "unit": "s"}))
    device.connect(1.0)
    assert scanner.functions == {103: "VOLT:DC", 102: "TEMP FRTD,85"}
    assert scanner.temperature_unit == "C"
    assert scanner.scanned == [102, 103]
    device.close()


def test_a_meter_must_measure_the_unit_of_its_channel(scanner: ScpiServer) -> None:
    settings = scpi_settings(scanner.port, dialect="single_meter", channels={"a": {"number": 101, "unit": "V"}})
    for scanner.function in ('"VOLT"', '"VOLT:DC"'):
        with closing(ScpiDevice("meter", settings)) as device:
            device.connect(1.0)
    for scanner.function in ('"VOLT:AC"', "RES"):
        sentence = f"the instrument measures {scanner.function}; expected voltage"
        with closing(ScpiDevice("meter", settings)) as device, pytest.raises(DeviceError, match=sentence):
            device.connect(1.0)


def test_a_meter_that_is_switched_to_another_function_is_named(scanner: ScpiServer) -> None:
    settings = scpi_settings(scanner.port, dialect="single_meter", channels={"a": {"number": 101, "unit": "V"}})
    scanner.answer = "+1.0"
    with running(ScpiDevice("meter", settings)) as reader:
        wait_for_frames(reader)
        scanner.function = '"CURR:AC"'
        wait_for_reported_fault(reader, 'the instrument measures "CURR:AC"; expected voltage')


def test_the_end_of_one_instrument_leaves_the_others(scanner: ScpiServer) -> None:
    with ScpiServer(ramp) as other:
        one, two = (ScpiDevice("meter", scpi_settings(each.port)) for each in (scanner, other))
        for device in (one, two):
            assert "DAQ970A" in device.connect(1.0)
        one.close()
        assert len(two.ask()) == 2
        two.close()


def test_an_unknown_host_is_named() -> None:
    with pytest.raises(DeviceError, match="no connection to"):
        LabJackDevice("box", labjack_settings(502, host="no.such.host.invalid")).connect(1.0)


@pytest.mark.parametrize("host", ["a..b", "no.such.host.invalid", ""])
def test_a_host_that_is_none_is_refused(host: str) -> None:
    with pytest.raises(DeviceError):
        ScpiDevice("meter", scpi_settings(5025, address=f"TCPIP::{host}::5025::SOCKET")).connect(1.0)


def test_frames_that_follow_a_late_one_quickly_are_found() -> None:
    """Of 200 questions per second one is answered late, and the next ones at once."""
    reader = DeviceReader(LabJackDevice("box", labjack_settings(502, channels={"a": {"input": 0}})))
    times_ms = np.array([0, 5, 10, 19, 20, 21, 25, 30])
    values = 0.1 * times_ms[:, None]
    reader._store(Frames(np.arange(8), values, 1_000_000 * times_ms), 0)
    for time_us in range(2600, 27_500, 700):
        found = reader.values_at(1000 * time_us)
        assert found is not None, time_us
        assert found[0] == pytest.approx(1e-4 * time_us)
