"""Base class of all devices, and their registry. Read this file to add a device.

How to add a device:

1. Declare its keys in a subclass of ``DeviceSettings``. They are the keys of a device in an instruments file.
2. Derive the device from ``Device``: ``connect``, ``read`` and ``close``. Each is called in one thread, which
   reconnects after a ``DeviceError``; ``stream_device.py`` is a short example. A device that must be asked for each
   frame is a ``PolledDevice``: ``connect``, ``ask`` and ``close``; ``labjack_device.py`` is an example.
3. Register the class under its ``kind`` in the entry point group ``posor_drivers.devices`` of its package's
   ``setup.py``: ``"posor_drivers.devices": ["mybox = my_package.mybox:MyBox"]``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, TypeVar

from posor_estimator.calibration.file_model import FrozenModel
from posor_estimator.calibration.quantity import Quantity, measured
from posor_estimator.errors import PosorError

from posor_drivers.simulator.scenario_limits import NOT_NEGATIVE, POSITIVE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.numerics.array_types import FloatArray, IntArray

ENTRY_POINT_GROUP = "posor_drivers.devices"


class DeviceError(PosorError):
    """A device cannot be reached, or answers something else than expected."""


class DeviceSettings(FrozenModel):
    """Keys of a device in an instruments file; a subclass adds those of its kind."""

    kind: str
    delay: Annotated[Quantity, measured("s"), NOT_NEGATIVE] = Quantity(value=0.0, unit="s")
    """Least time from the exposure of a frame to its arrival, which arrivals cannot show."""
    trigger_tolerance: Annotated[Quantity, measured("s"), POSITIVE] | None = None
    """Of a device whose frames are triggered by hardware at the ticks: largest time from a tick to its frame, which is
    then not interpolated, only checked."""


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
            frames. The counter of the device, without wrap.
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


class Device(ABC, Generic[SettingsT]):
    """One device; errors are a ``DeviceError`` with the name of the device as ``where``.

    Attributes:
        Settings: Model of the device's keys.
        name: Name in the instruments file.
        settings: The keys.

    """

    Settings: ClassVar[type[DeviceSettings]]

    def __init__(self, name: str, settings: SettingsT) -> None:
        """Store the settings; ``connect`` opens the connection."""
        self.name = name
        self.settings = settings

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return example values of all keys but ``kind``, for ``posor instruments start``.

        Args:
            units: Units of the readings by the names that the channels shall have. A reading that the device cannot
                measure is left out; the unit of a channel may be another one.

        """
        return {"channels": {name: {"unit": unit} for name, unit in units.items()}}

    @property
    @abstractmethod
    def channels(self) -> Sequence[Channel]:
        """The channels, in the order of the values; known without a connection."""

    @property
    @abstractmethod
    def frame_rate(self) -> float:
        """Nominal number of frames per second [Hz]; known without a connection."""

    @property
    def longest_interval_s(self) -> float:
        """Longest time between two frames that are interpolated [s]."""
        return 1.0 / self.frame_rate

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
            The frames; None where none came within the time.

        Raises:
            DeviceError: The connection was lost, or what came is no frame.

        """

    @abstractmethod
    def close(self) -> None:
        """Close the connection, if there is one; must not raise."""


def registered_devices() -> dict[str, EntryPoint]:
    """Return the entry points of all kinds of devices by name."""
    return {entry.name: entry for entry in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda entry: entry.name)}
