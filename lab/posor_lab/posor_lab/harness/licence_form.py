# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The header of the source files for ``ament_copyright``, which knows the long form of each licence only.

An entry point of the group ``ament_copyright.license`` registers it.
"""

from __future__ import annotations

from typing import NamedTuple


class LicenceForm(NamedTuple):
    """Attributes that ``ament_copyright`` reads; texts without copyright lines."""

    name: str
    spdx: str
    file_headers: tuple[str, ...]
    license_files: tuple[str, ...]
    contributing_files: tuple[str, ...]


APACHE2_SPDX = LicenceForm(
    "Apache License, Version 2.0 (SPDX)",
    "Apache-2.0",
    ("{copyright}\nSPDX-License-Identifier: Apache-2.0",),
    (),
    ("Contributions are under the licence of the repository, Apache-2.0.",),
)
