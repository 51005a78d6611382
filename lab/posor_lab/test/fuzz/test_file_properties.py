# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files of every format with one entry replaced by anything: a valid object or one sentence, never another error.

``fuzz_files`` damages bytes, which mostly gives invalid YAML; these files parse and are wrong in one entry.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from posor.errors import PosorError
from posor_lab.fuzz.fuzz_command import readers

YAML_FORMATS = ("calibration", "beams", "arm", "scenario", "table map")
TEXTS = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=12)
NUMBERS = st.one_of(st.floats(), st.integers(), st.sampled_from((0, 1, -1, 10**400, 1e300, 5e-324)))
SCALARS = st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS, st.dates())
ANYTHING = st.recursive(
    SCALARS, lambda part: st.one_of(st.lists(part, max_size=4), st.dictionaries(TEXTS, part, max_size=3)), max_leaves=8
)
CELLS = st.one_of(NUMBERS.map(str), TEXTS)


def places(content: Any) -> list[tuple[Any, Any]]:
    keys = content.keys() if isinstance(content, dict) else range(len(content)) if isinstance(content, list) else ()
    return [place for key in list(keys) for place in ((content, key), *places(content[key]))]


def check(name: str, text: str, folder: Path) -> None:
    source, read = readers()[name]
    path = folder / f"changed{source.suffix}"
    path.write_text(text, encoding="utf-8")
    try:
        read(path)
    except PosorError as error:
        assert "\n" not in str(error)  # noqa: PT017  any other error fails the test


def quick_or_long(quick: int, long: int) -> Any:
    """Return the parameters of a test: the number of examples, of which many are marked long."""
    return pytest.mark.parametrize(
        "examples", [quick, pytest.param(long, marks=[pytest.mark.long, pytest.mark.timeout(600)])]
    )


def examples_of(count: int) -> settings:
    kinds = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
    return settings(max_examples=count, derandomize=True, deadline=None, database=None, suppress_health_check=kinds)


@quick_or_long(8, 400)
@pytest.mark.parametrize("name", YAML_FORMATS)
def test_a_yaml_file_with_another_entry(name: str, examples: int, tmp_path: Path) -> None:
    text = readers()[name][0].read_text(encoding="utf-8")

    @examples_of(examples)
    @given(st.data())
    def run(data: st.DataObject) -> None:
        content = yaml.safe_load(text)
        container, key = data.draw(st.sampled_from(places(content)))
        if data.draw(st.booleans()):
            container[key] = data.draw(ANYTHING)
        else:
            del container[key]
        check(name, yaml.safe_dump(content, sort_keys=False, allow_unicode=True), tmp_path)

    run()


@quick_or_long(8, 400)
def test_a_urdf_with_another_attribute(examples: int, tmp_path: Path) -> None:
    text = readers()["urdf"][0].read_text(encoding="utf-8")

    @examples_of(examples)
    @given(st.data())
    def run(data: st.DataObject) -> None:
        root = ET.fromstring(text)  # noqa: S314  our own file
        element = data.draw(st.sampled_from([each for each in root.iter() if each.attrib]))
        element.set(data.draw(st.sampled_from(sorted(element.attrib))), data.draw(CELLS))
        check("urdf", ET.tostring(root, encoding="unicode"), tmp_path)

    run()


@quick_or_long(8, 400)
def test_a_table_with_another_cell(examples: int, tmp_path: Path) -> None:
    lines = readers()["table"][0].read_text(encoding="utf-8").splitlines()
    comments = [line for line in lines if line.startswith("#")]
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))

    @examples_of(examples)
    @given(row=st.integers(0, len(rows) - 1), column=st.integers(0, len(rows[0]) - 1), cell=CELLS)
    def run(row: int, column: int, cell: str) -> None:
        changed = [list(each) for each in rows]
        changed[row][column] = cell
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows(changed)
        check("table", "\n".join([*comments, out.getvalue()]), tmp_path)

    run()
