"""Tables and texts of the package, kept as YAML files beside the modules."""

from functools import cache
from pathlib import Path
from typing import Any

import yaml


@cache
def read_data(name: str) -> Any:
    """Return the content of the file ``name``.yaml."""
    return yaml.safe_load(Path(__file__).with_name(f"{name}.yaml").read_text(encoding="utf-8"))
