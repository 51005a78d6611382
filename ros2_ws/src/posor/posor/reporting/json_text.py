# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Text of a JSON file; a number that is not finite is null."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np


def json_text(content: Any, *, indent: int) -> str:
    """Return the text of a JSON file; a number in dictionaries, lists and tuples that is not finite is null."""
    return json.dumps(_with_null(content), indent=indent, allow_nan=False) + "\n"


def _with_null(part: Any) -> Any:
    if isinstance(part, dict):
        return {key: _with_null(value) for key, value in part.items()}
    if isinstance(part, list | tuple):
        return [_with_null(value) for value in part]
    if isinstance(part, float | np.floating):
        return float(part) if math.isfinite(part) else None
    return part
