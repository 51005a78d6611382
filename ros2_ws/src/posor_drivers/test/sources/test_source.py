# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Base classes and registry of sources: an instrument defines only its rate and its readings."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import EntryPoint

import pytest
from posor.errors import ParameterError
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS
from posor.parameter_model import ParameterGroup
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from posor_drivers.sources import source
from posor_drivers.sources.source import LiveSource, SourceMessage, Topic, load_source_class


class BoxParameters(ParameterGroup):
    port: str


class BoxSource(LiveSource[BoxParameters]):
    Parameters = BoxParameters
    rate = 1000

    @property
    def record(self) -> str:
        return self.parameters.port

    def open(self) -> Sequence[Topic]:
        return [Topic(RAW_TOPIC, RAW_SCAN)]

    def read_tick(self, tick: int) -> Sequence[SourceMessage]:
        return [SourceMessage(RAW_TOPIC, self.publication_time_ns(tick), b"")]


def test_live_source_has_the_ticks_of_the_clock_and_no_inputs_by_default() -> None:
    box = BoxSource(BoxParameters(port="/dev/box"), MessageTypes())
    now_ns = 5 * NS + 1
    assert box.start_run(now_ns) == (5001, None)
    assert box.newest_tick(now_ns) == 5000
    assert box.publication_time_ns(5001) == 5 * NS + NS // 1000
    assert box.inputs() == ()


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ("no_such_module:Box", "no_such_module:Box cannot be loaded, No module named 'no_such_module'."),
        ("pathlib:Box", "pathlib:Box cannot be loaded, module 'pathlib' has no attribute 'Box'."),
        ("pathlib:Path", "pathlib:Path is another class; expected a subclass of Source."),
    ],
)
def test_invalid_entry_point_is_refused(monkeypatch: pytest.MonkeyPatch, value: str, sentence: str) -> None:
    entry = EntryPoint("box", value, source.ENTRY_POINT_GROUP)
    monkeypatch.setattr(source, "registered", lambda _group: {"box": entry})
    with pytest.raises(ParameterError) as refused:
        load_source_class("box")
    assert str(refused.value) == f"parameter 'source', 'box': {sentence}"
