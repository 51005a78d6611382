"""Waits for the states of a device reader."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from posor_lab.harness.program import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_drivers.instruments.device_reader import DeviceReader


def wait_for(condition: Callable[[], object], what: str) -> None:
    """Look every 10 ms whether the condition holds."""
    wait_until(lambda: bool(condition()), what, lambda: time.sleep(0.01))


def wait_for_frames(reader: DeviceReader) -> None:
    """Wait until frames come, whose time is known."""
    wait_for(lambda: not reader.state.fault, "frames")


def wait_for_fault(reader: DeviceReader, words: str = "") -> None:
    """Wait until there is a fault with these words."""
    wait_for(lambda: reader.state.fault and words in reader.state.fault, f"fault with '{words}'")
