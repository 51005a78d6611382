"""Where in a file an entry stands."""

from __future__ import annotations

from dataclasses import dataclass

import yaml


@dataclass(frozen=True)
class Places:
    """Tells where the entries of a file stand.

    Attributes:
        source: The file.
        root: Its content, as ``read_yaml`` returns it.

    """

    source: str
    root: yaml.Node | None

    def of(self, *location: str | int) -> str:
        """Return ``file, line n, key a.b[0].c``.

        Args:
            location: Keys and indices that lead to the entry. A part that is not in the file (a key that is missing,
                the tag of a union) is left out. Of a part with dots the file may have the groups as mappings.

        """
        node = self.root
        line = 1
        key = ""
        parts = [*reversed(location)]
        while parts:
            part = parts.pop()
            if isinstance(node, yaml.MappingNode):
                entry = _entry(node, str(part))
                if entry is not None:
                    name, node = entry
                    line = name.start_mark.line + 1
                    key += f".{name.value}"
                    if name.value != str(part):
                        parts.append(str(part).removeprefix(f"{name.value}."))
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
                line = node.start_mark.line + 1
                key += f"[{part}]"
        return f"{self.source}, line {line}" + (f", key {key.lstrip('.')}" if key else "")


def _entry(node: yaml.MappingNode, key: str) -> tuple[yaml.Node, yaml.Node] | None:
    """Return a mapping's key and value of that name, or else of a group of that name."""
    found = [entry for entry in node.value if entry[0].value == key]
    groups = [entry for entry in node.value if key.startswith(f"{entry[0].value}.")]
    # A key that a merge brought in stands before one that replaces it.
    return next(iter([*reversed(found), *reversed(groups)]), None)
