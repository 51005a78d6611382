# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Print the lines of source, tests and documentation of each package, and their sums: ``make lines``.

``code``: lines of source in Python without blank lines, comments and docstrings.
"""

from __future__ import annotations

import io
import subprocess
import tokenize
from collections import Counter
from pathlib import Path

from environment import THIS

KINDS = ("source", "code", "tests", "docs")
PRODUCT = "ros2_ws/src"
EMPTY = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
}


def classify_file(path: Path) -> tuple[str, str] | None:
    """Return the package and the kind of a tracked file, or None for a file that does not count."""
    parts = path.parts
    package = "/".join(parts[:3]) if path.is_relative_to(PRODUCT) else parts[0] if len(parts) > 1 else "."
    if path.suffix == ".md":
        return package, "docs"
    if path.suffix in {".py", ".sh", ".msg"}:
        return package, "tests" if {"test", "tests"} & set(parts) or path.name == "conftest.py" else "source"
    return None


def count_code(source: bytes) -> int:
    """Return the lines of a Python file without blank lines, comments and docstrings."""
    code: set[int] = set()
    before = tokenize.NEWLINE
    tokens = list(tokenize.tokenize(io.BytesIO(source).readline))
    for token, following in zip(tokens, [*tokens[1:], tokens[-1]], strict=True):
        is_alone = before not in {tokenize.STRING, tokenize.OP, tokenize.NAME} and following.type == tokenize.NEWLINE
        if token.type not in EMPTY and not (token.type == tokenize.STRING and is_alone):
            code.update(range(token.start[0], token.end[0] + 1))
        if token.type not in {tokenize.COMMENT, tokenize.NL}:
            before = token.type
    return len(code)


def count_lines() -> Counter[tuple[str, str]]:
    """Return the lines of all tracked files that exist, by package and kind."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=THIS.root, capture_output=True, text=True, check=True)  # noqa: S607
    lines: Counter[tuple[str, str]] = Counter()
    for name in filter(None, listing.stdout.split("\0")):
        key = classify_file(Path(name))
        file = THIS.root / name
        if key and file.is_file():
            content = file.read_bytes()
            lines[key] += content.count(b"\n")
            if key[1] == "source" and file.suffix == ".py":
                lines[key[0], "code"] += count_code(content)
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
    for name, folder in (("product", PRODUCT), ("lab", "lab"), ("tools", "tools")):
        print(f"{name}: {total('source', folder):,} lines of source, {total('code', folder):,} of code")
    print(f"tests of all folders: {total('tests'):,} lines")


if __name__ == "__main__":
    main()
