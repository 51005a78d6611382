# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""One mutation in a process of its own: ``python -m posor_lab.mutations.mutated_model`` prints the checks as JSON.

Standard input holds the mutation. The source of its module is changed while it is imported; no file is written. The
kernels must not be compiled, because machine code would be that of the unchanged source.
"""

from __future__ import annotations

import json
import os
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import CodeType, ModuleType

TABLE = Path(__file__).with_name("mutation_table.yaml")


class Mutation(NamedTuple):
    """A row of the table."""

    name: str
    module: str  # of the product
    text: str  # of its source, which occurs once
    by: str  # what replaces it
    covariances: bool = False  # whether the checks of covariances run


def load_mutations() -> list[Mutation]:
    """Return the table."""
    return [Mutation(**row) for row in yaml.safe_load(TABLE.read_text(encoding="utf-8"))]


class _MutatedLoader(SourceFileLoader):
    """Loads a module from its changed source, without the bytecode of the unchanged one."""

    mutation: Mutation

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        source = Path(path).read_text(encoding="utf-8")
        if source.count(self.mutation.text) != 1:
            sys.exit(f"{source.count(self.mutation.text)} places of {fullname} have the text; expected 1")
        return compile(source.replace(self.mutation.text, self.mutation.by), path, "exec")


class MutatingFinder(MetaPathFinder):
    """Finds the module of a mutation."""

    def __init__(self, mutation: Mutation) -> None:
        self._mutation = mutation

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module with a loader that changes it; None: another module."""
        if fullname != self._mutation.module:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.origin is not None:
            spec.loader = _MutatedLoader(fullname, spec.origin)
            spec.loader.mutation = self._mutation
        return spec


def main() -> int:
    """Run the checks with one mutation; print their results."""
    if os.environ.get("POSOR_KERNELS") != "python":
        sys.exit("the kernels are compiled; expected POSOR_KERNELS=python")
    mutation = Mutation(**json.load(sys.stdin))
    sys.meta_path.insert(0, MutatingFinder(mutation))
    from posor_lab.mutations.model_checks import run_checks  # noqa: PLC0415  imports the product

    results: dict[str, Any] = run_checks(covariances=mutation.covariances)
    if mutation.module not in sys.modules:
        sys.exit(f"no check imports {mutation.module}")
    print(json.dumps(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
