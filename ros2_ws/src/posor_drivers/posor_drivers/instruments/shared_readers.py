"""Readers that the joints of one process share, so that each device is connected to once."""

from __future__ import annotations

from contextlib import contextmanager
from threading import Lock
from typing import TYPE_CHECKING, Any

from posor_drivers.instruments.device_reader import DeviceReader

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor_drivers.instruments.device import Device

_lock = Lock()
_readers: dict[tuple[str, str, str], DeviceReader] = {}
_users: dict[tuple[str, str, str], int] = {}


@contextmanager
def shared_reader(file: Path, device: Device[Any]) -> Iterator[DeviceReader]:
    """Yield the running reader of a device: that of another user in this process, if there is one.

    Args:
        file: The instruments file. A device of the same name and with the same settings in the same file is the same.
        device: The device, not connected.

    """
    key = (str(file.resolve()), device.name, device.settings.model_dump_json())
    with _lock:
        if key not in _readers:
            _readers[key] = DeviceReader(device)
            _readers[key].start()
        _users[key] = _users.get(key, 0) + 1
        reader = _readers[key]
    try:
        yield reader
    finally:
        with _lock:
            _users[key] -= 1
            if not _users[key]:
                del _readers[key], _users[key]
                reader.stop()
