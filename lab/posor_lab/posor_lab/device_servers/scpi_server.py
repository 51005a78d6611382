# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counterpart of a scanner with SCPI commands: the server of scpipy, with faults on demand."""

from __future__ import annotations

import asyncio
import socket
import time
from functools import partial
from threading import Event
from typing import TYPE_CHECKING, Any

from scpipy.server import Router, Server
from scpipy.shared.errors import ScpiError

from posor_lab.device_servers.device_server import HOST, DeviceServer, free_port, read_in_turn

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FIRST_CHANNEL = 101
POLL_S = 0.01


class ScpiServer(DeviceServer):
    """Answers the commands of a Keysight DAQ970A that measure DC voltages, one channel after another."""

    def __init__(self, voltages: Callable[[int], Sequence[float]]) -> None:
        """Choose a port; ``voltages`` are those of channel 101, 102, ... by the ROS time [ns]."""
        super().__init__()
        self.add_task(lambda: asyncio.run(self._run()))
        self.port = free_port()  # TCP port of this host
        self.model = "DAQ970A"  # in the answer to ``*IDN?``
        self.scanned: list[int] = []  # channel numbers of the scan list, ascending
        self.functions: dict[int, str] = {}  # what the channels have been set up for
        self.temperature_unit = ""  # as written
        self.function = '"VOLT"'  # answer to ``FUNC?``
        # that the next scan puts into the error queue: code and message of each
        self.errors: list[tuple[int, str]] = []
        self.answer: str | None = None  # instead of the readings of a scan; None: the readings
        self.outputs: list[tuple[int, int]] = []  # values and numbers of digital outputs, as written
        self.interval_s = 0.0  # time from channel to channel: the settings that a client has written
        self.stalled = Event()  # no scan is answered while it is set
        self._voltages = voltages
        self._server: Any = None
        self._loop: Any = None

    def start(self) -> None:
        """Accept connections."""
        router = Router()
        router.add_route("*IDN?", self._identify)
        router.add_route("CONFigure:VOLTage:DC <channels>", partial(self._configure, "VOLT:DC"))
        router.add_route("CONFigure:TEMPerature <channels>", partial(self._configure, "TEMP"))
        router.add_route("UNIT:TEMPerature <channels>", self._set_unit)
        router.add_route("CONFigure? <channels>", self._tell_functions)
        router.add_route("ROUTe:SCAN?", self._list_channels)
        router.add_route("FUNCtion?", self._name_function)
        router.add_route("ROUTe:SCAN <channels>", self._choose_channels)
        for command in (
            "ROUTe:CHANnel:DELay <value>",
            "SENSe:VOLTage:DC:APERture <value>",
            "SENSe:TEMPerature:APERture <value>",
        ):
            router.add_route(command, self._add_to_interval)
        router.add_route("SOURce:DIGital:DATA <value>", self._write_output)
        router.add_route("READ?", self._read)
        self._server = Server(HOST, self.port, shared_context=True)
        self._server.include_router(router)
        super().start()
        self._wait_until_open()

    def stop(self) -> None:
        """Close all connections."""
        self.stalled.clear()
        self._loop.call_soon_threadsafe(self._server.stop)
        super().stop()

    async def _run(self) -> None:
        self._loop = asyncio.get_running_loop()
        await self._server._listen()  # noqa: SLF001  run() would leave no loop to stop it from another thread

    def _wait_until_open(self) -> None:
        while True:
            try:
                socket.create_connection((HOST, self.port)).close()
            except ConnectionRefusedError:
                time.sleep(POLL_S)
            else:
                return

    def _identify(self, context: Any) -> str:
        del context
        return f"Keysight Technologies,{self.model},MY12345678,A.02.04"

    def _configure(self, function: str, context: Any, *arguments: str) -> None:
        """Store the function of channels, such as ``FRTD,85,(@101,103)``, cut at its commas, and scan them."""
        first = next(n for n, argument in enumerate(arguments) if argument.startswith("("))
        self._choose_channels(context, *arguments[first:])
        self.functions |= dict.fromkeys(self.scanned, " ".join([function, ",".join(arguments[:first])]).strip())

    def _tell_functions(self, context: Any, *channels: str) -> str:
        del context
        return ",".join(f'"{self.functions.get(int(each.strip("(@)")))}"' for each in channels)

    def _list_channels(self, context: Any) -> str:
        del context
        return f"(@{','.join(map(str, self.scanned))})"

    def _name_function(self, context: Any) -> str:
        del context
        return self.function

    def _set_unit(self, context: Any, unit: str, *channels: str) -> None:
        del context, channels
        self.temperature_unit = unit

    def _choose_channels(self, context: Any, *channels: str) -> None:
        """Store a scan list such as ``(@101,103)``, which the library cuts at its commas."""
        del context
        self.scanned = sorted(int(number.strip("(@)")) for number in channels)
        self.interval_s = 0.0

    def _add_to_interval(self, context: Any, value: str, *channels: str) -> None:
        """Add a channel delay or an aperture [s] to the time of each channel."""
        del context, channels
        self.interval_s += float(value)

    def _write_output(self, context: Any, value: str, *channels: str) -> None:
        del context
        self.outputs.append((int(value), int(channels[0].strip("(@)"))))

    async def _read(self, context: Any) -> str:
        while self.stalled.is_set():  # noqa: ASYNC110  set by another thread
            await asyncio.sleep(POLL_S)
        while self.errors:
            context.push_error(ScpiError(*self.errors.pop(0)))
        if self.answer is not None:
            return self.answer
        channels = [number - FIRST_CHANNEL for number in self.scanned]
        voltages = read_in_turn(self._voltages, time.time_ns(), channels, self.interval_s)
        await asyncio.sleep((len(channels) - 1) * self.interval_s)
        return ",".join(f"{volts:+.9E}" for volts in voltages)
