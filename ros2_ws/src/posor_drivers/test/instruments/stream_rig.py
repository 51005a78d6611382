# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""An instruments file of one joint, ``elbow``, with one device, ``box``, of the kind ``stream``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from posor.calibration.design_parts import quantity_entry
from posor_lab.device_servers.stream_server import LEAD, MAGIC


def stream_rig(
    port: int, units: Mapping[str, str], joint: dict[str, Any], rate_hz: float = 1000, latency_s: float = 0.05
) -> dict[str, Any]:
    """Return the file; ``units`` are those of the channels, ``joint`` holds the readings."""
    box = {
        "kind": "stream",
        "transport": "tcp",
        "host": "127.0.0.1",
        "port": port,
        "rate": quantity_entry(rate_hz, "Hz"),
        "format": f"{LEAD}{len(units)}d",
        "fields": ["magic", "counter", *units],
        "constants": {"magic": MAGIC},
        "channels": {name: {"unit": unit} for name, unit in units.items()},
    }
    return {
        "format": "posor_instruments",
        "version": 1,
        "name": "rig",
        "rate": quantity_entry(100, "Hz"),
        "latency": quantity_entry(latency_s, "s"),
        "devices": {"box": box},
        "joints": {"elbow": {"frame_id": "receiving", **joint}},
    }


def write_rig(folder: Path, content: dict[str, Any]) -> str:
    path = folder / "instruments.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return str(path)
