# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Print the lines of source, tests and documentation of each package, and their sums: ``make lines``."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path

from environment import THIS

KINDS = ("source", "tests", "docs")
PRODUCT = "ros2_ws/src"


def classify_file(path: Path) -> tuple[str, str] | None:
    """Return the package and the kind of a tracked file, or None for a file that does not count."""
    parts = path.parts
    package = "/".join(parts[:3]) if path.is_relative_to(PRODUCT) else parts[0] if len(parts) > 1 else "."
    if path.suffix == ".md":
        return package, "docs"
    if path.suffix in {".py", ".sh", ".msg"}:
        return package, "tests" if {"test", "tests"} & set(parts) or path.name == "conftest.py" else "source"
    return None


def count_lines() -> Counter[tuple[str, str]]:
    """Return the lines of all tracked files that exist, by package and kind."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=THIS.root, capture_output=True, text=True, check=True)  # noqa: S607
    lines: Counter[tuple[str, str]] = Counter()
    for name in filter(None, listing.stdout.split("\0")):
        key = classify_file(Path(name))
        file = THIS.root / name
        if key and file.is_file():
            lines[key] += file.read_bytes().count(b"\n")
    return lines


def main() -> None:
    """Print the table and the sums."""
    lines = count_lines()

    def total(kind: str, folder: str = "") -> int:
        return sum(n for (package, other), n in lines.items() if other == kind and package.startswith(folder))

    print(f"{'package':<32}" + "".join(f"{kind:>10}" for kind in KINDS))
    for package in sorted({package for package, _ in lines}):
        print(f"{package:<32}" + "".join(f"{lines[package, kind]:>10,}" for kind in KINDS))
    print(f"{'all':<32}" + "".join(f"{total(kind):>10,}" for kind in KINDS))
    print(f"product: source of {PRODUCT} {total('source', PRODUCT):>11,}")
    print(f"lab: source of lab {total('source', 'lab'):>23,}")
    print(f"tests of all folders {total('tests'):>21,}")
    print(f"tools: source of tools {total('source', 'tools'):>19,}")


if __name__ == "__main__":
    main()
