"""Print the lines of source, tests and documentation of each package: ``make lines``."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path

from environment import THIS

KINDS = ("source", "tests", "docs")


def classify_file(path: Path) -> tuple[str, str] | None:
    """Return the package and the kind of a tracked file, or None for a file that does not count."""
    parts = path.parts
    package = parts[2] if parts[:2] == ("ros2_ws", "src") else parts[0] if len(parts) > 1 else "."
    if path.suffix == ".md":
        return package, "docs"
    if path.suffix in {".py", ".sh", ".msg"}:
        return package, "tests" if {"test", "tests"} & set(parts) or path.name == "conftest.py" else "source"
    return None


def main() -> None:
    """Count the lines of all tracked files that exist."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=THIS.root, capture_output=True, text=True, check=True)  # noqa: S607
    lines: Counter[tuple[str, str]] = Counter()
    for name in filter(None, listing.stdout.split("\0")):
        key = classify_file(Path(name))
        file = THIS.root / name
        if key and file.is_file():
            lines[key] += file.read_bytes().count(b"\n")
    print(f"{'package':<20}" + "".join(f"{kind:>10}" for kind in KINDS))
    for package in sorted({package for package, _ in lines}):
        print(f"{package:<20}" + "".join(f"{lines[package, kind]:>10,}" for kind in KINDS))
    totals = [sum(count for (_, other), count in lines.items() if other == kind) for kind in KINDS]
    print(f"{'all':<20}" + "".join(f"{total:>10,}" for total in totals))


if __name__ == "__main__":
    main()
