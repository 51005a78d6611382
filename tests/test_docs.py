# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Documentation: the links lead to files, and generated pages equal the declarations."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from types import ModuleType

import document_calculators
import document_messages
import document_parameters
import pytest
from environment import THIS

LINK = re.compile(r"\]\((?!https?://)([^)#\s]*)(?:#[^)]*)?\)")


def tracked_pages() -> list[Path]:
    listing = subprocess.run(["git", "ls-files", "*.md"], cwd=THIS.root, capture_output=True, text=True, check=True)  # noqa: S607
    return [path for name in listing.stdout.splitlines() if (path := THIS.root / name).is_file()]


GENERATORS = (document_parameters, document_calculators, document_messages)


@pytest.mark.parametrize("generator", GENERATORS, ids=lambda each: each.PAGE.stem)
def test_generated_page_equals_the_declarations(generator: ModuleType) -> None:
    assert generator.PAGE.read_text(encoding="utf-8") == generator.render_page(), "call 'make docs'"


@pytest.mark.parametrize("page", tracked_pages(), ids=lambda page: str(page.relative_to(THIS.root)))
def test_links_lead_to_files(page: Path) -> None:
    targets = [target for target in LINK.findall(page.read_text(encoding="utf-8")) if target]
    assert not [target for target in targets if not (page.parent / target).exists()]


@pytest.mark.parametrize("name", ["ARCHITECTURE.md", "how_to/find_your_way.md", "reference/errors_and_diagnostics.md"])
def test_named_source_files_exist(name: str) -> None:
    page = (THIS.root / "docs" / name).read_text(encoding="utf-8")
    sources = [*THIS.ros2.glob("src/posor*"), *THIS.root.glob("lab/*")]
    packages = [package / package.name for package in sources]
    folders = [THIS.root, THIS.ros2 / "src", *sources, *packages]
    missing = [
        path
        for path in re.findall(r"`([\w./]+/[\w.]+\.(?:py|msg|xml))`", page)
        if not any((folder / path).exists() for folder in folders)
    ]
    assert not missing


def test_index_lists_every_page() -> None:
    folder = THIS.root / "docs"
    index = (folder / "index.md").read_text(encoding="utf-8")
    pages = {str(page.relative_to(folder)) for page in folder.rglob("*.md")} - {"index.md"}
    assert pages <= set(LINK.findall(index))
