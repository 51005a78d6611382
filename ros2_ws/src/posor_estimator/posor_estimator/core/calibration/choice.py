"""A part of a calibration file that is of one of several kinds, which one of its keys names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import BeforeValidator

from posor_estimator.core.calibration.entry import EntryError, shown

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.calibration.part import FrozenModel


def chosen_by(key: str, kinds: Mapping[str, type[FrozenModel]]) -> BeforeValidator:
    """Return the annotation of a union of models that takes the model which the value of ``key`` names.

    Other than a discriminated union of pydantic, it leaves the place of an error what it is in the file.
    """

    def choose(part: object) -> object:
        if isinstance(part, tuple(kinds.values())):
            return part
        if not isinstance(part, dict):
            raise EntryError(shown(part), expected="a mapping")
        if key not in part:
            raise EntryError(f"key '{key}' is missing")
        name = part[key]
        if not isinstance(name, str) or name not in kinds:
            several = "one of " if len(kinds) > 1 else ""
            known = several + ", ".join(f"'{kind}'" for kind in sorted(kinds))
            raise EntryError(f"{key} {shown(name)}", key=(key,), expected=known)
        return kinds[name].model_validate(part)

    return BeforeValidator(choose)
