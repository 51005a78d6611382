"""Write requirements/*.txt, the exact versions, from requirements/*.in, the libraries that the project names.

All lists are resolved together first, so that one version of each library serves all of them, and with the oldest
supported Python, since libraries drop old Pythons but keep new ones.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

OLDEST = (3, 11)
FOLDER = Path(__file__).resolve().parent.parent / "requirements"
HEADER = "# Written by `make lock` from {name}.in: edit that file, not this one.\n"


def resolve(*options: str) -> dict[str, str]:
    """Ask pip which distributions and versions it would install into an empty environment."""
    pip = [sys.executable, "-I", "-m", "pip", "install", "--dry-run", "--ignore-installed", "-qq", "--report", "-"]
    answer = subprocess.run(
        [*pip, "--disable-pip-version-check", *options], stdout=subprocess.PIPE, text=True, check=True
    )
    found = [entry["metadata"] for entry in json.loads(answer.stdout)["install"]]
    return {entry["name"]: entry["version"] for entry in found}


def pinned(versions: dict[str, str]) -> str:
    """Return one ``name==version`` line for each distribution, in alphabetical order."""
    return "".join(f"{name}=={versions[name]}\n" for name in sorted(versions, key=str.lower))


def main() -> int:
    """Resolve and write all lock files."""
    if sys.version_info[:2] != OLDEST:
        oldest = ".".join(map(str, OLDEST))
        sys.stderr.write(f"make lock: needs Python {oldest}, the oldest supported: make lock PYTHON=python{oldest}.\n")
        return 1
    lists = sorted(FOLDER.glob("*.in"))
    together = resolve(*(f"--requirement={path}" for path in lists))
    with tempfile.TemporaryDirectory() as scratch:
        constraints = Path(scratch, "constraints.txt")
        constraints.write_text(pinned(together), encoding="utf-8")
        for path in lists:
            versions = resolve(f"--requirement={path}", f"--constraint={constraints}")
            path.with_suffix(".txt").write_text(HEADER.format(name=path.stem) + pinned(versions), encoding="utf-8")
            sys.stdout.write(f"{path.stem}: {len(versions)} libraries\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
