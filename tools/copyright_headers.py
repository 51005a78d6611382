# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check that each source file begins with the copyright header, or add it: ``tools/copyright_headers.py [--add]``.

Source files are Python modules, shell scripts and C++; an empty file needs no header. Standard library only.
"""

from __future__ import annotations

import subprocess
import sys

from environment import THIS

HEADER = "Copyright 2026 POSOR maintainers", "SPDX-License-Identifier: Apache-2.0"
SUFFIXES = (".py", ".sh", ".cpp")
SCRIPTS = {"posor", "run", ".ci/run"}  # shell scripts without a suffix


def header_of(name: str) -> str:
    """Return the header of a file as a comment of its language."""
    mark = "//" if name.endswith(".cpp") else "#"
    return "".join(f"{mark} {line}\n" for line in HEADER)


def split_shebang(text: str) -> tuple[str, str]:
    """Return the first line if it names the interpreter, and the rest."""
    end = text.find("\n") + 1 if text.startswith("#!") else 0
    return text[:end], text[end:]


def files_without_header() -> list[str]:
    """Return the tracked source files that need the header and do not begin with it."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=THIS.root, capture_output=True, text=True, check=True)  # noqa: S607
    names = [name for name in listing.stdout.split("\0") if name.endswith(SUFFIXES) or name in SCRIPTS]
    texts = {name: (THIS.root / name).read_text(encoding="utf-8") for name in names if (THIS.root / name).is_file()}
    return [name for name, text in texts.items() if text and not split_shebang(text)[1].startswith(header_of(name))]


def main() -> int:
    """Name the files without header, or with ``--add`` change them; return the exit code."""
    missing = files_without_header()
    if "--add" in sys.argv[1:]:
        for name in missing:
            path = THIS.root / name
            shebang, text = split_shebang(path.read_text(encoding="utf-8"))
            path.write_text(shebang + header_of(name) + text, encoding="utf-8")
        print(f"added to {len(missing)} files")
        return 0
    for name in missing:
        print(f"{name}: begins without the copyright header; tools/copyright_headers.py --add adds it")
    return bool(missing)


if __name__ == "__main__":
    sys.exit(main())
