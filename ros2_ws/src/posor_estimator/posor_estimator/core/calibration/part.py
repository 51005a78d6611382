"""What all parts of a calibration file, and of any other file of its manner, have in common."""

from __future__ import annotations

import difflib
from functools import cached_property

from pydantic import BaseModel, ConfigDict, model_validator

from posor_estimator.core.calibration.entry import TEXT, EntryError, shown


class FrozenModel(BaseModel):
    """Base of everything in such a file: immutable, and a key that is not known is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", ignored_types=(cached_property,))

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: object) -> object:
        """Name an unknown key before what is missing in its place."""
        if isinstance(data, cls):
            return data
        if not isinstance(data, dict):
            raise EntryError(shown(data), expected="a mapping")
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in data:
            if not isinstance(key, str):
                raise EntryError(f"key {shown(key)} is not text", key=(key,), expected=TEXT)
            if key not in known:
                free = [name for name in known if name not in data]
                close = difflib.get_close_matches(key, free, n=1)
                expected = f"'{close[0]}'" if close else "a key of the format"
                raise EntryError(f"unknown key '{key}'", key=(key,), expected=expected)
        return data
