# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reserves a name on this host for one process, such as the namespace of an arm or the light of an instrument."""

from __future__ import annotations

import errno
import socket
from hashlib import sha256
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posor.errors import PosorError


def claim(name: str, refusal: PosorError) -> socket.socket:
    """Return the claim of a name; it lasts until it is closed, or until the process ends in any way.

    The claim is an abstract Unix socket (Linux, unix(7)), whose names the kernel holds: unlike a lock file, a killed
    process leaves none. Processes of one network namespace see each other's claims, as they do their ROS nodes.
    Raises ``refusal``: another process has claimed the name.
    """
    claimed = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claimed.bind(f"\0posor:{sha256(name.encode()).hexdigest()}")
    except OSError as error:
        claimed.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise refusal from None
    return claimed
