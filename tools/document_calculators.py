# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write docs/reference/design_calculators.md from the registered calculators: ``make docs``."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from environment import THIS
from posor_design.calculator_signature import read_signature
from posor_design.calculators import CALCULATORS
from posor_design.value_kinds import format_value, name_kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_design.calculator_signature import CalculatorSignature, Value

PAGE = THIS.root / "docs" / "reference" / "design_calculators.md"
WIDTH = 110
"""Letters of a line of an example."""
INTRODUCTION = """# Design calculators

`posor design NAME` computes a part of a POSOR or of its structure from dimensions. `make docs` writes this page from
the functions in `posor_design/`; `posor design NAME --help` prints the same.

## Minimal example

    EXAMPLE

The command prints each result with its unit. An argument is a number with a unit, such as `'60 in'`, `'5/32 in'`,
`'10.6e6 psi'` or `'0.1 lb/in^3'`; without a unit it has the SI unit of the table. A space, `*` or `-` multiplies units,
`/` divides by the one unit that follows, `^` is a power. `lb` is a mass and `lbf` a force. Commas separate several
values of one argument, as in `'6, 24 in'`. A negative number is written `--name=-3`.

| option | function |
|---|---|
| `--json FILE` | write arguments and results in SI units |
| `--html FILE` | write a page, with the effect of each argument on each result |

Each calculator is a function of the public Python API, with arguments and results in SI units:

```python
from posor_design import FUNCTION
```

A wrong argument is one sentence and exit code 2. [`make thesis`](../background/thesis_table.md) compares these
functions with the numbers that the thesis prints.

"""


def render_page() -> str:
    """Return the page as Markdown."""
    signatures = [read_signature(name) for name in CALCULATORS]
    first = signatures[0]
    introduction = INTRODUCTION.replace("    EXAMPLE", _command(first)).replace("FUNCTION", first.function.__name__)
    index = "| calculator | computes |\n|---|---|\n"
    index += "".join(f"| [{each.name}](#{each.name}) | {_cell(each.summary)} |\n" for each in signatures)
    return "\n".join([introduction + index, *map(_render_calculator, signatures)])


def _render_calculator(signature: CalculatorSignature) -> str:
    arguments = [(*_value_cells(each), _default(each)) for each in signature.arguments]
    results = [_value_cells(each) for each in signature.results]
    parts = [
        f"## {signature.name}\n\n{signature.summary}.",
        signature.description,
        _command(signature),
        _table(("argument", "unit", "meaning", "default"), arguments),
        _table(("result", "unit", "meaning"), results),
        f"Function: `posor_design.{signature.function.__name__}`. Source: {signature.source}",
    ]
    return "\n\n".join(filter(None, parts)).replace("``", "`") + "\n"


def _command(signature: CalculatorSignature) -> str:
    lines = textwrap.wrap("./" + signature.example, WIDTH, break_long_words=False, break_on_hyphens=False)
    return "```sh\n" + " \\\n".join(lines) + "\n```"


def _value_cells(value: Value) -> tuple[str, ...]:
    return f"`{value.name}`", name_kind(value.kind), value.description


def _default(argument: Value) -> str:
    return "" if argument.required else format_value(argument.kind, argument.default)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def _cell(text: str) -> str:
    return text.replace("|", r"\|")


if __name__ == "__main__":
    PAGE.write_text(render_page(), encoding="utf-8")
