# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What posor_node and chain_node of one process exchange in place of messages, see ``DeliveryGroup.take``."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from posor.messages.message_stream import RawScanStream

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_ros.intra_process import IntraProcessSubscription


class JointStream(RawScanStream):
    """The raw scans of a joint; ``taker`` may take the transform of the scan of ``prepare``."""

    taker: IntraProcessSubscription | None = None


class TakenScans(NamedTuple):
    """Prepared scans of all joints of an arm, whose transforms chain_node takes."""

    run: Callable[[], bool]  # estimates scans and endpoint in one call; False: the endpoint needs the messages
    publish: Callable[[], None]  # publishes the endpoint after the run
