# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: INP001  Sphinx reads this file, nothing imports it
"""Settings of Sphinx for the documentation site: ``make docs`` builds it into ``build/docs``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "POSOR for ROS 2"
copyright = "POSOR maintainers"  # noqa: A001  the name is Sphinx's
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4
napoleon_use_ivar = True  # Scans has docstrings of its properties too: describe them once
html_theme = "furo"
html_show_sphinx = False

LINK = re.compile(r"\[[^]]*\]\((?!\w+:)([^)#\s]+)(?:#[^)\s]*)?\)")


def name_outside_files(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace links to files outside docs, which the site does not hold, by their paths in the repository."""
    site = Path(app.srcdir)
    folder = (site / page).parent

    def path_or_link(link: re.Match[str]) -> str:
        target = (folder / link[1]).resolve()
        if target.is_relative_to(site) or not target.exists():
            return link[0]
        return f"`{target.relative_to(site.parent)}`"

    source[0] = LINK.sub(path_or_link, source[0])


def skip_field(_app: Sphinx, _what: str, _name: str, member: object, _skip: object, _options: object) -> bool | None:
    """Leave out the fields of named tuples: the docstring of the class has them; None: as autodoc decides."""
    return True if (member.__doc__ or "").startswith("Alias for field number") else None


def setup(app: Sphinx) -> None:
    """Register the functions."""
    app.connect("source-read", name_outside_files)
    app.connect("autodoc-skip-member", skip_field)
