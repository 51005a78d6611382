# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lines of code are those of a file without blank lines, comments and docstrings."""

from __future__ import annotations

from count_lines import count_code

SOURCE = b'''"""A module."""
# A comment.

TEXT = """two
lines"""


def f(x: int) -> str:
    """Return

    something."""
    return (
        # why
        "text"
    )
'''


def test_lines_of_code_have_no_blank_lines_comments_and_docstrings() -> None:
    assert count_code(SOURCE) == 6  # two of TEXT, one of def, three of return
