# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from itertools import count
from pkgutil import resolve_name
from threading import Thread
from time import sleep

import pytest
from posor_lab.benchmark.stage_profile import STAGES, Stopwatches


def test_time_of_a_stage_excludes_the_stages_that_it_calls() -> None:
    watches = Stopwatches()
    inner = watches.timed(sleep, "inner")

    def work() -> None:
        sleep(0.02)
        inner(0.05)
        inner(0.05)

    watches.timed(work, lambda: "outer")()
    other = Thread(target=inner, args=(0.0,))
    other.start()
    other.join()
    times = watches.stage_times()
    assert {name: calls for name, (calls, _) in times.items()} == {"inner": 2, "outer": 1}
    assert times["inner"][1] >= 99_000
    assert times["outer"][1] >= 19_000
    assert times["outer"][1] + times["inner"][1] >= 119_000
    watches.restart()
    assert watches.stage_times() == {}


def test_cost_of_the_stopwatches_is_subtracted() -> None:
    watches = Stopwatches(count(step=40).__next__)  # reading the clock takes 40 ns, everything else no time
    nothing = watches.timed(lambda: None, "nothing")

    def call_it() -> None:
        for _ in range(1000):
            nothing()

    watches.timed(call_it, "caller")()
    times = watches.stage_times()
    assert {name: calls for name, (calls, _) in times.items()} == {"nothing": 1000, "caller": 1}
    assert [us for _, us in times.values()] == pytest.approx([0.0, 0.0], abs=0.2)


@pytest.mark.parametrize("place", STAGES)
def test_stages_of_the_profile_exist(place: str) -> None:
    assert callable(resolve_name(place))
