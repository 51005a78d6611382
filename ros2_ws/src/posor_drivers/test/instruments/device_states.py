# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device readers that run, and waits for their states."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from posor_drivers.instruments.device import Device
from posor_drivers.instruments.device_reader import DeviceReader
from posor_lab.harness.program import wait_until


@contextmanager
def running(device: Device[Any]) -> Iterator[DeviceReader]:
    reader = DeviceReader(device)
    reader.start()
    try:
        yield reader
    finally:
        reader.stop()


def wait_for(condition: Callable[[], object], what: str) -> None:
    wait_until(lambda: bool(condition()), what, lambda: time.sleep(0.01))


def wait_for_frames(reader: DeviceReader) -> None:
    """Wait until frames come, whose time is known."""
    wait_for(lambda: not reader.state.fault, "frames")


def wait_for_values(reader: DeviceReader) -> int:
    """Wait until the frames of the present time have come, and return this ROS time [ns]."""
    now_ns = time.time_ns()
    wait_for(lambda: reader.values_at(now_ns) is not None, "the frames until now")
    return now_ns


def wait_for_fault(reader: DeviceReader) -> None:
    """Wait for a fault that stays."""
    wait_for(lambda: reader.state.fault, "a fault")


def wait_for_reported_fault(reader: DeviceReader, words: str) -> None:
    """Wait for a fault with these words, which may have passed meanwhile; it is then no longer reported."""
    wait_for(lambda: words in reader.take_state().fault, f"fault with '{words}'")
