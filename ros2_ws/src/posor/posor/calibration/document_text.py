# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write the content of a file as YAML, for files that programs make: quantities on one line, repeated parts in full."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from posor.calibration.yaml_document import WIDTH, StrictDumper


class _FlowMapping(dict[str, Any]):
    """A mapping that is written on one line."""


class _Dumper(StrictDumper):
    """Writes each quantity on one line, and repeated parts in full."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        """Return True: write no aliases."""
        return True


_Dumper.add_representer(
    _FlowMapping, lambda dumper, part: dumper.represent_mapping("tag:yaml.org,2002:map", part.items(), flow_style=True)
)


def document_text(content: Any, comment: str) -> str:
    """Return content as the text of a file, numbers with twelve digits, below a line of comment.

    Empty parts and standard uncertainties of zero are left out.
    """
    text = yaml.dump(_file_content(content), Dumper=_Dumper, sort_keys=False, width=WIDTH, allow_unicode=True)
    return f"# {comment}\n{text}"


def _file_content(part: Any) -> Any:
    if isinstance(part, dict):
        if set(part) in ({"value", "sigma", "unit"}, {"value", "unit"}):
            quantity = {key: _file_content(entry) for key, entry in part.items()}
            if "sigma" in quantity and not np.any(quantity["sigma"]):
                del quantity["sigma"]
            return _FlowMapping(quantity)
        return {key: _file_content(entry) for key, entry in part.items() if entry is not None and entry not in ({}, [])}
    if isinstance(part, list | tuple):
        return [_file_content(entry) for entry in part]
    return float(f"{part:.12g}") + 0.0 if isinstance(part, float) else part
