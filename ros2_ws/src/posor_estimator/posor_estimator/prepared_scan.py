# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A raw scan between its check and its estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from posor.messages.message_stream import RawScanStream
    from posor_ros.intra_process import IntraProcessSubscription


class PreparedScan(NamedTuple):
    """A raw scan that the next run of its stream estimates."""

    subscription: Any  # of posor_node, by which the scan came
    stream: RawScanStream
    data: bytes  # the scan as a serialised message
    taker: IntraProcessSubscription | None  # of chain_node, whose group may take the transform
