# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write the definitions of messages and services into docs/reference/messages.md: ``make docs``."""

from __future__ import annotations

import re

from environment import THIS

PAGE = THIS.root / "docs" / "reference" / "messages.md"
DEFINITIONS = THIS.ros2 / "src" / "posor_msgs"


def render_page() -> str:
    """Return the page; a section whose title names a message or a service shows its definition."""

    def section(title: re.Match[str]) -> str:
        [path] = [*DEFINITIONS.glob(f"msg/{title[1]}.msg"), *DEFINITIONS.glob(f"srv/{title[1]}.srv")]
        return f"## {title[1]}\n\n```text\n{path.read_text(encoding='utf-8').strip()}\n```\n"

    page = PAGE.read_text(encoding="utf-8")
    names = sorted(path.stem for folder in ("msg", "srv") for path in DEFINITIONS.glob(f"{folder}/*.{folder}"))
    page += "".join(f"\n## {name}\n\n```text\n```\n" for name in names if f"## {name}\n" not in page)
    return re.sub(r"^## (\w+)\n\n```.*?^```\n", section, page, flags=re.DOTALL | re.MULTILINE)


if __name__ == "__main__":
    PAGE.write_text(render_page(), encoding="utf-8")
