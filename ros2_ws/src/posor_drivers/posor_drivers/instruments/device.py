# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Base class of all devices, and their registry. Read this file to add a device.

How to add a device:

1. Declare its keys in a subclass of ``DeviceSettings``. They are the keys of a device in an instruments file. With a
   key ``channels``, a mapping from names to models that have a ``unit``, the device has these channels; without it,
   declare ``channels`` in the device.
2. Derive the device from ``Device``: ``Settings``, ``address``, ``connect`` and ``read``. ``connect`` stores what it
   opens in ``connection``. Both are called in one thread, which closes ``connection`` and connects again after a
   ``DeviceError``; ``stream_device.py`` is a short example. A device that must be asked for each frame is a
   ``PolledDevice``, with ``ask`` in place of ``read``; ``labjack_device.py`` is an example. One that sends packets over
   TCP is a ``PacketDevice``, with ``take_packet`` in place of ``read``; ``capancdt_device.py`` is an example.
3. Register the class under its ``kind`` in the entry point group ``posor_drivers.devices`` of its package's
   ``setup.py``: ``"posor_drivers.devices": ["mybox = my_package.mybox:MyBox"]``.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from ipaddress import ip_address
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Literal, TypeVar

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.errors import PosorError
from posor.plugins import load_class, registered
from pydantic import AfterValidator, Field

from posor_drivers.instruments.channel_exposures import ExposureEntry, Exposures, find_exposures
from posor_drivers.quantity_limits import POSITIVE, Delay

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from posor.numerics.array_types import FloatArray, IntArray

ENTRY_POINT_GROUP = "posor_drivers.devices"

LONGEST_GAP = 1 << 20
"""Most frames that may be lost where a counter wraps, 4.5 minutes at 4 kHz; beyond, the counter went back."""

Port = Annotated[int, Field(strict=True, ge=1, le=65_535)]
_ADDRESS = re.compile(r"[0-9.]*|.*:.*")  # texts that can only be an IP address
_HOST_NAME = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*\.?")


def _check_host(host: str) -> str:
    try:
        is_valid = bool(ip_address(host.partition("%")[0]) if _ADDRESS.fullmatch(host) else _HOST_NAME.fullmatch(host))
    except ValueError:
        is_valid = False
    if not is_valid:
        raise EntryError(f"host '{host}'", expected="a host name or an IP address, without a port")
    return host


Host = Annotated[str, AfterValidator(_check_host)]


class DeviceError(PosorError):
    """A device cannot be reached, or answers something else than expected."""


class DeviceSettings(FrozenModel):
    """Keys of a device in an instruments file; a subclass adds those of its kind."""

    kind: str
    rate: Annotated[Quantity, measured("Hz"), POSITIVE]
    """Nominal number of frames per second."""
    delay: Delay = Quantity(value=0.0, unit="s")
    """Least time from the last exposure of a frame to its arrival, which arrivals cannot show, and its uncertainty."""
    trigger_tolerance: Annotated[Quantity, measured("s"), POSITIVE] | None = None
    """Of a device whose frames are triggered by hardware at the ticks: largest time from a tick to its frame, which is
    then not interpolated, only checked. The first channel is read at the tick."""
    exposures: Literal["simultaneous", "unknown"] | ExposureEntry | None = None
    """When the channels of a frame are read; None: as the device finds from its other keys."""


SettingsT = TypeVar("SettingsT", bound=DeviceSettings)


@dataclass(frozen=True)
class Channel:
    """A channel of a device."""

    name: str
    unit: str
    """Of its values, such as ``V``, ``m`` or ``A``."""


@dataclass(frozen=True)
class Frames:
    """Consecutive frames of a device, as one read has delivered them.

    Attributes:
        counters: Number of each frame, (n,), in the order of arrival; each frame of the device counts, so a gap is lost
            frames. The counter of the device, without wrap (``FrameCounter``). The reader decides whether a number that
            goes back is a late frame or a restart of the device.
        values: Value of each channel, (n, c), in the unit of the channel; NaN where the device flags it as invalid.
        times_ns: ROS time of each frame [ns], (n,), where the device or the way of asking it gives one; None: the
            reader finds it from counters and arrivals.
        time_uncertainty_s: Standard uncertainty of ``times_ns`` [s].
        arrived_ns: ROS time at which the last frame was received [ns], before it was decoded; None: the reader takes
            the time at the end of ``read``.

    """

    counters: IntArray
    values: FloatArray
    times_ns: IntArray | None = None
    time_uncertainty_s: float = 0.0
    arrived_ns: int | None = None


class FrameCounter:
    """Numbers frames by a counter of the device that wraps."""

    def __init__(self, size: int) -> None:
        """Start without a frame; the counter wraps from ``size`` - 1 to 0."""
        self._size, self._last = size, -1

    def number(self, counter: int, count: int = 1) -> int:
        """Return the number of the first of ``count`` frames, which goes on where the counter wraps.

        It goes back where the counter does, as for a late frame or after a restart of the device: of a step forwards
        and one backwards the smaller is taken, and no wrap loses more than ``LONGEST_GAP`` frames.
        """
        before = self._last % self._size
        step = (counter - before) % self._size
        if self._last >= 0 and (2 * step >= self._size or (counter < before and step > LONGEST_GAP)):
            step -= self._size
        number = counter if self._last < 0 else self._last + step
        self._last = number + count - 1
        return number


class Device(ABC, Generic[SettingsT]):
    """One device; errors are a ``DeviceError`` with the name of the device as ``where``.

    Attributes:
        Settings: Model of the device's keys.
        name: Name in the instruments file.
        settings: The keys.
        connection: What ``connect`` has opened, an object with a method ``close``; None: not connected.
        channel_interval_s: Time from channel to channel in the order of reading [s]; 0: the device reads all channels
            at one time; NaN: unknown. Final after ``connect``.

    """

    channel_interval_s = 0.0
    Settings: ClassVar[type[DeviceSettings]]

    def __init__(self, name: str, settings: SettingsT) -> None:
        """Store the settings; ``connect`` opens the connection."""
        self.name = name
        self.settings = settings
        self.connection: Any = None

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return example values of all keys but ``kind``, for ``posor instruments start``.

        Args:
            units: Units of the readings by the names that the channels shall have. A reading that the device cannot
                measure is left out; the unit of a channel may be another one.

        """
        return {"channels": {name: {"unit": unit} for name, unit in units.items()}}

    @property
    def channels(self) -> Sequence[Channel]:
        """The channels, in the order of the values: those of the key ``channels``; known without a connection."""
        settings: Any = self.settings
        return [Channel(name, channel.unit) for name, channel in settings.channels.items()]

    @property
    def frame_rate(self) -> float:
        """Nominal number of frames per second [Hz]: the stated rate; known without a connection."""
        return self.settings.rate.number

    @property
    def longest_interval_s(self) -> float:
        """Longest time between two frames that are interpolated [s]."""
        return 1.0 / self.frame_rate

    @property
    def reading_order(self) -> Sequence[int]:
        """Place of each channel in the order in which a multiplexing device reads them, from 0 on."""
        return range(len(self.channels))

    @property
    def exposures(self) -> Exposures:
        """When the channels of a frame are read, final after ``connect``.

        Raises:
            DeviceError: The key ``exposures`` names a channel that does not exist.

        """
        names, entry = [channel.name for channel in self.channels], self.settings.exposures
        if isinstance(entry, ExposureEntry) and (unknown := sorted(entry.offsets.keys() - set(names))):
            raise self.error(f"an exposure of channel '{unknown[0]}'", f"one of {', '.join(names)}")
        return find_exposures(names, self.reading_order, self.channel_interval_s, 1.0 / self.frame_rate, entry)

    @property
    def incomplete_frame(self) -> str:
        """What has been received of the next frame, such as ``12 bytes without a line feed``; empty: nothing."""
        return ""

    @property
    @abstractmethod
    def address(self) -> str:
        """Where the device is, such as ``192.168.0.5:10001``, for messages."""

    @abstractmethod
    def connect(self, timeout_s: float) -> str:
        """Connect, check that this is the expected device, and start the frames; return what the device says it is.

        Raises:
            DeviceError: The device cannot be reached within the time, or is not the expected one.

        """

    @abstractmethod
    def read(self, timeout_s: float) -> Frames | None:
        """Return the frames that have come since the last call; wait for the first one.

        Returns:
            The frames; None if no frame arrived within the time.

        Raises:
            DeviceError: The connection was lost, or the received data are not a frame.

        """

    def close(self) -> None:
        """Close the connection, if there is one; must not raise."""
        if self.connection is not None:
            with suppress(Exception):  # of a connection that is broken
                self.connection.close()
            self.connection = None

    def error(self, what: str, expected: str) -> DeviceError:
        """Return an error of this device."""
        return DeviceError(what, where=self.name, expected=expected)


def starting_channels(units: Mapping[str, str], channel: Callable[[int], dict[str, Any]]) -> dict[str, Any]:
    """Return example settings of a channel, by its number, for each reading that is not a whole number (unit 1)."""
    return {name: channel(n) for n, name in enumerate(name for name, unit in units.items() if unit != "1")}


def refuse_repeated_numbers(numbers: Mapping[str, int]) -> None:
    """Check that the channels of a device, by name, have different numbers.

    Raises:
        EntryError: An earlier channel has the number too; names the later one.

    """
    names: dict[int, str] = {}
    for name, number in numbers.items():
        if names.setdefault(number, name) != name:
            raise EntryError(f"number {number}, used twice", key=("channels", name), expected="a number for each")


def device_kinds() -> tuple[str, ...]:
    """Return the names of all kinds of devices."""
    return tuple(registered(ENTRY_POINT_GROUP))


def device_class(kind: str) -> type[Device[Any]]:
    """Return the class of a kind of devices. Raises EntryError: it cannot be loaded."""
    found: type[Device[Any]] = load_class(
        registered(ENTRY_POINT_GROUP)[kind], Device, partial(EntryError, key=("kind",))
    )
    return found


def settings_of_kinds() -> dict[str, type[DeviceSettings] | EntryError]:
    """Return the class of the settings of each kind of devices, or why it cannot be loaded."""

    def settings(kind: str) -> type[DeviceSettings] | EntryError:
        try:
            return device_class(kind).Settings
        except EntryError as error:
            return error

    return {kind: settings(kind) for kind in device_kinds()}
