"""Where in a file an entry stands."""

from __future__ import annotations

import yaml


def place(source: str, root: yaml.Node | None, location: tuple[str | int, ...]) -> str:
    """Return ``file, line n, key a.b[0].c``.

    Args:
        source: The file.
        root: Its content, as ``read_yaml`` returns it.
        location: Keys and indices that lead to the entry. A part that is not in the file (a key that is missing, the
            tag of a union) is left out.

    """
    node = root
    line = 1
    key = ""
    for part in location:
        if isinstance(node, yaml.MappingNode):
            # A key that a merge brought in stands before one that replaces it.
            found = [entry for entry in node.value if entry[0].value == str(part)]
            if found:
                name, node = found[-1]
                line = name.start_mark.line + 1
                key += f".{part}"
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line + 1
            key += f"[{part}]"
    return f"{source}, line {line}" + (f", key {key.lstrip('.')}" if key else "")
