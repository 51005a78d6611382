# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import math

import numpy as np
from posor.reporting.json_text import json_text


def test_numbers_that_are_not_finite_are_null() -> None:
    content = {"a": [1.5, math.nan, np.float64(np.inf)], "b": {"c": (-math.inf, "text", True, None, 3)}}
    text = json_text(content, indent=1)
    assert text.endswith("\n")
    assert json.loads(text) == {"a": [1.5, None, None], "b": {"c": [None, "text", True, None, 3]}}
