# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The lock files are exact, complete and consistent, and keep the libraries of an installed ROS."""

from __future__ import annotations

import importlib.metadata
import re
from pathlib import Path

import pytest
from environment import THIS
from missing_requirements import find_missing
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pip._vendor.packaging.requirements import Requirement as PipRequirement
from setup_state import NAMED_LISTS, NAMED_LOCKS, WHEEL_LOCKS
from try_bounds import LIBRARY, bounds

FOLDER = THIS.root / "requirements"
NOBLE = "noble.txt"
LOCKS = (*WHEEL_LOCKS, "audit.txt")
PIN = re.compile(r"(?P<name>[A-Za-z0-9][A-Za-z0-9._-]*)==(?P<version>[A-Za-z0-9.]+)")


def lines(path: Path) -> list[str]:
    stripped = (line.partition("#")[0].strip() for line in path.read_text(encoding="utf-8").splitlines())
    return [line for line in stripped if line]


def pins(name: str) -> dict[str, str]:
    matches = [PIN.fullmatch(line) for line in lines(FOLDER / name)]
    assert all(matches), f"{name} holds a line other than NAME==VERSION"
    return {str(canonicalize_name(match["name"])): match["version"] for match in matches if match}


def test_every_list_has_its_lock_file() -> None:
    assert {path.stem for path in FOLDER.glob("*.in")} == {name.removesuffix(".txt") for name in (*LOCKS, NOBLE)}


@pytest.mark.parametrize("name", LOCKS)
def test_lock_meets_its_list(name: str) -> None:
    locked = pins(name)
    for line in lines((FOLDER / name).with_suffix(".in")):
        requirement = Requirement(line)
        assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)])


def test_the_library_and_the_list_state_the_same_bounds() -> None:
    of_library = bounds(LIBRARY / "setup.cfg")
    of_list = bounds(FOLDER / "base.in") | {
        name: bounds(FOLDER / "dev.in")[name] for name in ("h5py", "nptdms", "xmlschema")
    }
    different = {name for name in of_library.keys() & of_list.keys() if of_library[name][0] != of_list[name][0]}
    assert different == {"numpy", "scipy", "numba"}, "those of an official Jazzy"
    assert set(of_library) - set(of_list) == {"pandas", "pin"}


def test_the_lock_of_ubuntu_differs_by_the_versions_of_its_system_only() -> None:
    of_system = dict(line.split("==") for line in lines(FOLDER / "noble.in") if "==" in line)
    of_system = {str(canonicalize_name(name)): version for name, version in of_system.items()}
    found, others = pins(NOBLE), {library: version for name in LOCKS for library, version in pins(name).items()}
    assert found.items() >= of_system.items()
    assert {library: others[library] for library in found.keys() - of_system} == {
        library: version for library, version in found.items() if library not in of_system
    }
    for line in lines(FOLDER / "base.in"):
        requirement = Requirement(line)
        assert requirement.specifier.contains(found[canonicalize_name(requirement.name)]), line
    assert not {"pin", "mypy"} & found.keys()


def test_locks_have_one_version_of_each_library() -> None:
    versions: dict[str, str] = {}
    for name in LOCKS:
        for library, version in pins(name).items():
            assert versions.setdefault(library, version) == version


def test_document_names_every_library_with_its_locked_version() -> None:
    text = (THIS.root / "docs" / "reference" / "dependencies.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([\w.-]+) \| (\d[\w.]*) \|", text, re.MULTILINE)
    documented = {str(canonicalize_name(name)): version for name, version in rows}
    named = {
        str(canonicalize_name(Requirement(line).name)): name
        for name in LOCKS
        for line in lines((FOLDER / name).with_suffix(".in"))
    }
    assert documented == {library: pins(name)[library] for library, name in named.items()}


def test_locks_are_complete() -> None:
    """The locks contain every requirement of every installed library."""
    locked = {library: version for name in NAMED_LOCKS for library, version in pins(name).items()}
    here = {library: version for library, version in locked.items() if installed(library) == version}
    assert here
    for library in here:
        for text in importlib.metadata.requires(library) or []:
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                assert canonicalize_name(requirement.name) in locked, f"{library} needs {requirement}"


def installed(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return ""


def test_nothing_is_missing_here() -> None:
    named = [PipRequirement(line) for name in NAMED_LISTS for line in lines(FOLDER / name)]
    locked = {library: version for name in NAMED_LOCKS for library, version in pins(name).items()}
    assert find_missing(named, locked) == set()


@pytest.mark.parametrize(
    ("named", "locked", "missing_names"),
    [
        ("rich>=1", {"rich": "9999"}, set()),
        ("rich>=9999", {"rich": "9999"}, {"rich"}),
        ("no-such-library", {"no-such-library": "1.0"}, {"no-such-library"}),
        ("no-such-library", {}, set()),
        ("no-such-library; python_version < '3'", {"no-such-library": "1.0"}, set()),
        ("numpy>=9999", {"numpy": "9999"}, set()),
    ],
    ids=["recent enough", "too old", "absent", "not locked", "of another Python", "linked against"],
)
def test_libraries_missing_in_an_installed_ros(named: str, locked: dict[str, str], missing_names: set[str]) -> None:
    assert find_missing([PipRequirement(named)], locked) == missing_names
