# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables and texts of the package, kept as YAML files beside the modules."""

from functools import cache
from pathlib import Path
from typing import Any

from posor.calibration.yaml_document import parse_yaml


@cache
def read_data(name: str) -> Any:
    """Return the content of the file ``name``.yaml."""
    path = Path(__file__).with_name(f"{name}.yaml")
    return parse_yaml(path.read_text(encoding="utf-8"), str(path))[1]
