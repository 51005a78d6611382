# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compare the pinned libraries with the known vulnerabilities in the database of PyPI: ``make audit``.

Exit code 0: none is known; 1: some are, one line each; 2: the audit was not possible.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from environment import THIS, exit_with

REQUIREMENTS = THIS.root / "requirements"
LOCK = REQUIREMENTS / "audit.txt"
TOOL = THIS.root / "build" / "audit"
"""Folder of pip-audit and its libraries."""
PROBE = "pip_audit=="
"""Begin of a pin that every database of PyPI knows."""
NOT_POSSIBLE = 2
PIP = [sys.executable, "-I", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--upgrade"]
AUDIT = ["-m", "pip_audit", "--disable-pip", "--no-deps", "--progress-spinner=off", "--format=json"]


def install_tool() -> str:
    """Install pip-audit in the locked version unless it is there; return the reason if that is impossible."""
    stamp = TOOL / LOCK.name
    if stamp.is_file() and stamp.read_bytes() == LOCK.read_bytes():
        return ""
    done = subprocess.run(
        [*PIP, f"--target={TOOL}", f"--requirement={LOCK}"], stderr=subprocess.PIPE, text=True, check=False
    )
    if done.returncode:
        return f"pip-audit cannot be installed: {last_line(done.stderr)}"
    stamp.write_bytes(LOCK.read_bytes())
    return ""


def last_line(text: str) -> str:
    """Return the last line of the output of a program that failed."""
    return (text.strip().splitlines() or ["no reason was given"])[-1].rstrip(".")


def pins() -> list[str]:
    """Return all pins of all lock files, each once."""
    lines = (line for path in REQUIREMENTS.glob("*.txt") for line in path.read_text(encoding="utf-8").splitlines())
    return sorted({line for line in lines if line and not line.startswith("#")}, key=str.lower)


def audit(lines: list[str]) -> list[dict[str, Any]]:
    """Return what pip-audit reports of each library; of one that is not in the database, ``skip_reason``.

    Raises:
        OSError: The database cannot be reached.

    """
    with tempfile.TemporaryDirectory() as folder:
        report, requirements = Path(folder, "report.json"), Path(folder, "requirements.txt")
        requirements.write_text("\n".join(lines), encoding="utf-8")
        command = [sys.executable, *AUDIT, f"--output={report}", f"--requirement={requirements}"]
        environ = {**os.environ, "PYTHONPATH": str(TOOL)}
        done = subprocess.run(command, env=environ, stderr=subprocess.PIPE, text=True, check=False)
        if not report.is_file() or not report.stat().st_size:
            raise OSError(last_line(done.stderr))
        libraries: list[dict[str, Any]] = json.loads(report.read_text(encoding="utf-8"))["dependencies"]
        return libraries


def main() -> int:
    """Run the audit."""
    if reason := install_tool():
        return refuse(reason)
    lines = pins()
    try:
        probe = audit([line for line in lines if line.startswith(PROBE)])
        if "skip_reason" in probe[0]:
            return refuse("this package index has no database of vulnerabilities")
        libraries = audit(lines)
    except OSError as error:
        return refuse(f"the database of vulnerabilities cannot be read: {error}")
    skipped = [library["name"] for library in libraries if "skip_reason" in library]
    known = [(library, entry) for library in libraries for entry in library.get("vulns", ())]
    for library, entry in known:
        fixed = ", ".join(entry["fix_versions"]) or "no version yet"
        print(f"{library['name']} {library['version']}: {entry['id']}, fixed in {fixed}")
    if skipped:
        print(f"not in the database: {', '.join(skipped)}")
    print(f"make audit: {len(libraries) - len(skipped)} libraries, {len(known)} known vulnerabilities")
    return 1 if known else 0


def refuse(reason: str) -> int:
    """Print why the audit is not possible; return the exit code."""
    sys.stderr.write(f"make audit: {reason}; expected a connection to pypi.org.\n")
    return NOT_POSSIBLE


if __name__ == "__main__":
    exit_with("make audit", main)
