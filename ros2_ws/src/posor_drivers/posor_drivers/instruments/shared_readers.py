# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readers of devices that the joints of a process share."""

from __future__ import annotations

from contextlib import contextmanager
from threading import Lock
from typing import TYPE_CHECKING, Any

from posor_drivers.instruments.device_reader import DeviceReader

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor_drivers.instruments.device import Device

_sharing = Lock()
_readers: dict[tuple[str, str, str], DeviceReader] = {}
_users: dict[tuple[str, str, str], int] = {}


@contextmanager
def shared_reader(file: Path, device: Device[Any]) -> Iterator[DeviceReader]:
    """Yield the running reader of a device, which all users of it in this process share.

    A device of the same name and with the same settings in the same instruments file is the same.
    """
    key = (str(file.resolve()), device.name, device.settings.model_dump_json())
    with _sharing:
        if key not in _readers:
            _readers[key] = DeviceReader(device)
            _readers[key].start()
        _users[key] = _users.get(key, 0) + 1
        reader = _readers[key]
    try:
        yield reader
    finally:
        with _sharing:
            _users[key] -= 1
            if not _users[key]:
                del _readers[key], _users[key]
                reader.stop()
