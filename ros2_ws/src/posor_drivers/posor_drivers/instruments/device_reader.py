# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads a device in a thread that joints share, finds the ROS time of its frames, and keeps the newest."""

from __future__ import annotations

import math
import time
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from posor.numerics.stamps import NS

from posor_drivers.instruments.channel_exposures import Exposures
from posor_drivers.instruments.clock_mapping import ClockMapping
from posor_drivers.instruments.device import DeviceError
from posor_drivers.instruments.frame_store import CAPACITY, FrameStore
from posor_drivers.instruments.interpolation import MOST_WEIGHT, FrameWeights, frame_weights
from posor_drivers.instruments.trigger_arrivals import TriggerArrivals
from posor_drivers.instruments.value_ages import ValueAges

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray

    from posor_drivers.instruments.device import Device, Frames

COUNTS = ("frames", "frames_lost", "frames_late", "frames_dropped", "frames_repeated", "connections")
"""Counts in the diagnostics: frames stored; frames missing; of those stored, the ones that arrived after their
successors; frames that arrived too late; frames that arrived again."""
CONNECT_TIMEOUT_S = 1.0
READ_TIMEOUT_S = 0.1
PAUSE_S = 0.004
"""Between two reads of a device that sends by itself: each costs processor time, whatever number of frames has come."""
STALL_S = 0.3
"""Longest time without a new frame number, and at least STALL_FRAMES nominal periods."""
STALL_FRAMES = 5
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 1.0
"""Pause before a connection is tried again: doubled with each failure."""
SINGLE_FRAME = FrameWeights(0.0, 1.0, 0.0)
LATE_S = 0.5
"""How late a frame may arrive after its successors and still be stored; a counter further back may be a restart."""
RESTART_S = 0.1
"""Time in which only frames that are further back arrive, after which the device has restarted."""
UNIFORM = math.sqrt(3.0)
"""Half-width of a uniform distribution, in standard deviations."""
MAX_DRIFT = 0.01
"""Share by which the frame rate may differ from the stated one."""


class DeviceState(NamedTuple):
    """State of a device for the diagnostics."""

    fault: str
    """What is wrong with the device; frames may still arrive."""
    text: str
    """What the device says it is."""
    values: dict[str, float | int]
    """Counts and the clock, by name."""


class StampError(NamedTuple):
    """Error of the times of frames."""

    uncertainty_s: float  # standard uncertainty [s]
    limit_s: float  # largest error [s]


class _Place(NamedTuple):
    """Where a time lies among the frames."""

    number: int  # of the nearest frame
    rows: list[int]  # of the frame before, the nearest one and the one after
    weights: FrameWeights
    shift_s: float  # by which a triggered frame may be off its tick [s]


class DeviceReader:
    """Reads one device until it is stopped; connects again after a fault.

    Attributes:
        device: The device.
        exposures: When its channels are read after the tick of ``values_at``: NaN where the exposure is unknown, 0
            where the channel is interpolated to the tick.

    """

    def __init__(self, device: Device[Any]) -> None:
        """Prepare; ``start`` connects."""
        self.device = device
        self._delay_ns = round(device.settings.delay.number * NS)
        tolerance = device.settings.trigger_tolerance
        self._tolerance_s = None if tolerance is None else tolerance.number
        self._thread = Thread(target=self._run, name=f"device {device.name}", daemon=True)
        self._stopping = Event()
        self._lock = Lock()
        self._place_channels()
        self._fault, self._identity = f"{device.name}: not connected yet", ""
        self._unreported = ""
        self._failure: Exception | None = None
        self._counts = dict.fromkeys(COUNTS, 0)
        self._forget_frames()

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and the connection."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def state(self) -> DeviceState:
        """The present state. Raises the exception that has ended the thread, which was no ``DeviceError``."""
        self._raise_failure()
        with self._lock:
            values: dict[str, float | int] = dict(self._counts)
            if self._timed:
                values["frame_rate"] = self._frames.timed_rate(self._first, int(self._last or 0))
            elif (line := self._mapping.line) is not None:
                values["frame_rate"] = NS / line.period_ns
                values["clock_drift"] = line.period_ns * self.device.frame_rate / NS - 1.0
            if (error := self._stamp_error()) is not None:
                values |= {"clock_uncertainty": error.uncertainty_s, "clock_limit": error.limit_s}
            fault = self._fault or self._trigger_fault or self._ages.fault(self.device)
            return DeviceState(fault, self._identity, values)

    def take_state(self) -> DeviceState:
        """Return the present state; once, the last fault since the call before, even if it has passed meanwhile."""
        state = self.state
        with self._lock:
            fault, self._unreported = self._unreported, ""
        return state._replace(fault=fault or state.fault)

    def values_at(self, time_ns: int, whole: Sequence[int] = ()) -> FloatArray | None:
        """Return the values of all channels at a ROS time [ns], (c,), interpolated between the three nearest frames.

        Each channel is interpolated by its own times of exposure; one whose exposure is unknown by those of the frames.
        Their noise is that of one frame, see ``interpolation``. None where one of the frames is missing (not there yet,
        lost, or before the connection), or where a column of ``whole`` differs between them: a channel that cannot be
        interpolated, such as the number of the lit source.

        Raises:
            Exception: What has ended the thread, if it was no ``DeviceError``.

        """
        self._raise_failure()
        with self._lock:
            if (places := self._places(time_ns)) is None:
                return None
            values = np.empty(len(self.exposures.offsets_s))
            for place, (_, columns) in zip(places, self._read_together, strict=True):
                weights = place.weights
                before, nearest, after = (self._frames.values[row] for row in place.rows)
                for column in whole:
                    if not before[column] == nearest[column] == after[column]:
                        return None
                # Equal frames keep their value to the last bit: it shows that a reading no longer changes.
                there = nearest + weights.before * (before - nearest) + weights.after * (after - nearest)
                values[columns] = there[columns]
            for column in whole:
                values[column] = nearest[column]
        return values

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def stamp_error_at(self, time_ns: int, columns: Sequence[int] = ()) -> StampError | None:
        """Return the error of the times of the frames around a ROS time [ns], with that of the stated least delay.

        ``columns``: the channels whose values change with the pose; the error contains their ages. None where the times
        are not known.
        """
        with self._lock:
            if (places := self._places(time_ns)) is None:
                return None
            error = self._stamp_error([row for place in places for row in place.rows])
            if error is None:
                return None
            numbers = [place.number for place in places]
            age_s = self._ages.age_s(min(numbers) - 1, max(numbers) + 1, columns)
            age_s += max(place.shift_s for place in places)
            weight = MOST_WEIGHT if self._tolerance_s is None else 1.0
            return StampError(math.hypot(error.uncertainty_s, age_s / UNIFORM), error.limit_s + weight * age_s)

    def _stamp_error(self, rows: list[int] | None = None) -> StampError | None:
        """Return the error of the times of frames, without their ages; by their rows, else of the newest."""
        delay_sigma_s = float(self.device.settings.delay.sigmas)
        if self._timed:
            stated_s = self._time_uncertainty_s if rows is None else self._frames.uncertainties_s[rows].max()
            uncertainty_s = float(stated_s)
            limit_s = UNIFORM * uncertainty_s * (1.0 if rows is None else MOST_WEIGHT)
        elif (line := self._mapping.line) is not None:
            uncertainty_s, limit_s = line.uncertainty_s, line.limit_s
        else:
            return None
        if self._tolerance_s is not None:
            limit_s = self._tolerance_s
        return StampError(math.hypot(uncertainty_s, delay_sigma_s), limit_s + UNIFORM * delay_sigma_s)

    def _place_channels(self) -> None:
        """Group the channels that are read together: time after that of the frame [ns], and their columns.

        The first channel of a triggered frame is read at the tick.
        """
        exposures = self.device.exposures
        offsets_s, half_s = np.array(exposures.offsets_s), exposures.half_span_s
        self._half_span_ns = round(half_s * NS)
        if self._tolerance_s is not None:
            self.exposures = exposures._replace(offsets_s=tuple((offsets_s + half_s).tolist()))
            self._read_together: list[tuple[int, Any]] = [(-self._half_span_ns, slice(None))]
            return
        remaining = np.where(np.isnan(offsets_s), np.nan, 0.0)
        # Values between frames are as far from an even motion as readings within the time between them.
        span_s = exposures.span_s if np.isnan(offsets_s).any() else self.device.longest_interval_s
        self.exposures = Exposures(tuple(remaining.tolist()), span_s)
        shifts_ns = np.round(np.nan_to_num(offsets_s) * NS).astype(np.int64)
        each = np.unique(shifts_ns).tolist()
        self._read_together = [
            (shift, np.flatnonzero(shifts_ns == shift) if each[1:] else slice(None)) for shift in each
        ]

    def _places(self, time_ns: int) -> list[_Place] | None:
        """Return the places of the channels that are read together, for a time; None where one is missing."""
        found = [self._place(time_ns - shift_ns) for shift_ns, _ in self._read_together]
        places = [place for place in found if place is not None]
        return places if len(places) == len(found) else None

    def _place(self, time_ns: int) -> _Place | None:
        """Return the three frames nearest to a time; None where one is missing, or a triggered one is off its tick."""
        found = self._timed_place(time_ns) if self._timed else self._mapped_place(time_ns)
        if found is None or (rows := self._frames.rows_around(found[0])) is None:
            return None
        number, weights, offset_s = found
        if self._triggers is None:
            return _Place(number, rows, weights, 0.0)
        frame = self._triggers.check(number, offset_s, None if self._timed else self._mapping.line)
        self._trigger_fault = frame.fault
        return _Place(number, rows, SINGLE_FRAME, frame.shift_s) if frame.is_usable else None

    def _timed_place(self, time_ns: int) -> tuple[int, FrameWeights, float] | None:
        """Return number of the frame nearest to a ROS time by the frames' own times, weights, and time after it [s].

        None where a frame is missing, or two are far apart.
        """
        found = None if self._last is None else self._frames.nearest(time_ns, self._last)
        if found is None or max(found.since_before_ns, found.until_after_ns) > self.device.longest_interval_s * NS:
            return None
        weights = frame_weights(found.since_before_ns, found.until_after_ns, found.offset_ns)
        return found.number, weights, found.offset_ns / NS

    def _mapped_place(self, time_ns: int) -> tuple[int, FrameWeights, float] | None:
        """Return the number of the frame nearest to a ROS time by the clock line, weights, and time after it [s]."""
        line = self._mapping.line
        if self._last is None or line is None:
            return None
        position = line.first + (time_ns - line.start_ns) / line.period_ns
        number = round(position)
        offset = position - number
        return number, frame_weights(1.0, 1.0, offset), offset * line.period_ns / NS

    def newest_values(self) -> FloatArray | None:
        """Return the values of the newest frame, (c,); None where there is none."""
        found = self.newest_frame()
        return None if found is None else found[1]

    def newest_frame(self) -> tuple[int, FloatArray] | None:
        """Return number and values (c,) of the newest frame; None where there is none. Raises as ``state``."""
        self._raise_failure()
        with self._lock:
            return None if self._last is None else (self._last, self._frames.values[self._last % CAPACITY].copy())

    def _forget_frames(self) -> None:
        self._mapping = ClockMapping(self.device.frame_rate)
        channels = len(self.device.channels)
        self._frames = FrameStore(channels, self.device.frame_rate)
        self._ages = ValueAges(self._frames, channels)
        self._triggers = None if self._tolerance_s is None else TriggerArrivals(self.device, self._tolerance_s)
        self._trigger_fault = ""
        self._timed: bool = False
        self._time_uncertainty_s = 0.0
        self._first = 0
        self._last: int | None = None
        self._back_since_s = np.inf

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._stopping.is_set():
            try:
                self._identity = self.device.connect(CONNECT_TIMEOUT_S)
                with self._lock:
                    self._place_channels()
                self._counts["connections"] += 1
                self._read_frames()
            except DeviceError as error:
                with self._lock:
                    pause_s = FIRST_PAUSE_S if self._last is not None else min(2.0 * pause_s, LONGEST_PAUSE_S)
                    self._fault = self._unreported = str(error)
                    self._forget_frames()
            except Exception as error:  # noqa: BLE001  the driver ends the program with it
                self._failure = error
                return
            finally:
                self.device.close()
            self._stopping.wait(pause_s)

    def _read_frames(self) -> None:
        """Read until the device fails or the reader is stopped."""
        device, last_frame_s = self.device, time.monotonic()
        last_new_number_s = last_frame_s
        stall_s = max(STALL_S, STALL_FRAMES / device.frame_rate)
        while not self._stopping.is_set():
            frames = device.read(READ_TIMEOUT_S)
            read_ns, now_s = time.time_ns(), time.monotonic()
            newest = self._last
            if frames is not None and len(frames.counters):
                arrived_ns = read_ns if frames.arrived_ns is None else frames.arrived_ns
                with self._lock:
                    self._store(frames, arrived_ns - self._delay_ns)
                last_frame_s = now_s
                if self._last != newest:
                    last_new_number_s = now_s
                elif now_s - last_new_number_s > stall_s:
                    what = f"the frame counter has not risen above {newest} for {now_s - last_new_number_s:.2f} s"
                    raise device.error(what, "ascending numbers")
            elif now_s - last_frame_s > stall_s:
                incomplete = f", but {device.incomplete_frame}" if device.incomplete_frame else ""
                what = f"no frame for {now_s - last_frame_s:.2f} s{incomplete}"
                raise device.error(what, f"{device.frame_rate:g} frames per second")
            if frames is not None and frames.times_ns is None:
                time.sleep(PAUSE_S)

    def _store(self, frames: Frames, arrived_ns: int) -> None:
        """Store frames that have arrived together.

        Raises:
            DeviceError: The counter went back, and stays back.

        """
        counters, counts = frames.counters, self._counts
        if self._last is None:
            self._first, self._last = int(counters[0]), int(counters[0]) - 1
        highest = np.maximum.accumulate(np.append(self._last, counters))
        new = counters > highest[:-1]
        if new.any():
            self._frames.write(frames, np.flatnonzero(new)[-CAPACITY:], self._delay_ns)
            counts["frames"] += int(np.count_nonzero(new))
            counts["frames_lost"] += int(highest[-1] - self._last - np.count_nonzero(new))
            self._last = int(highest[-1])
        for n in np.flatnonzero(~new).tolist():
            self._store_late(frames, n)
        if new.any():
            self._back_since_s = np.inf
        if frames.times_ns is not None:
            self._timed, self._time_uncertainty_s = True, frames.time_uncertainty_s
            self._fault = ""
        elif new.any():
            self._check_triggers(arrived_ns - self._half_span_ns)
            self._mapping.add(self._last, arrived_ns - self._half_span_ns)
            self._check_mapping()

    def _check_triggers(self, arrived_ns: int) -> None:
        """Keep the arrival of the newest triggered frame. Raises DeviceError: it cannot be that of its tick."""
        if self._triggers is None or self._last is None:
            return
        self._triggers.add(self._last, arrived_ns)
        if self._mapping.line is not None and (early_s := self._triggers.early_by_s(self._mapping.line)):
            what = f"frame {self._last} has arrived {1e3 * early_s:.3g} ms before its tick"
            raise self.device.error(what, "one frame for each tick; the device may have counted a false trigger")

    def _store_late(self, frames: Frames, n: int) -> None:
        """Store or drop a frame that does not come after all others."""
        number, newest, counts = int(frames.counters[n]), int(self._last or 0), self._counts
        row, back = self._frames.row_of(number), newest - number
        restarted = False
        if row is not None:
            same = np.array_equal(self._frames.values[row], frames.values[n], equal_nan=True)
            counts["frames_repeated"] += 1
            if not back and not same:
                what = f"frame {number} arrived twice, with different values"
                raise self.device.error(what, "each number once, from one device")
            restarted = not same
        elif back < min(CAPACITY, LATE_S * self.device.frame_rate):
            self._frames.write(frames, np.array([n]), self._delay_ns)
            counts["frames"] += 1
            counts["frames_late"] += 1
            counts["frames_lost"] -= number > self._first
        else:
            counts["frames_dropped"] += 1
            self._back_since_s = min(self._back_since_s, now_s := time.monotonic())
            restarted = now_s - self._back_since_s > RESTART_S
        if restarted:
            what = f"the frame counter went back from {newest} to {number}"
            raise self.device.error(what, "ascending numbers; the device may have restarted")

    def _check_mapping(self) -> None:
        """State why the frames cannot be used yet, or that they can.

        Raises:
            DeviceError: The frame rate is another than stated.

        """
        nominal, line = self.device.frame_rate, self._mapping.line
        if line is not None and abs((rate := NS / line.period_ns) / nominal - 1.0) > MAX_DRIFT:
            error = self.device.error(f"{rate:.6g} frames per second", f"{nominal:g}, as stated")
            # Other threads must not use this line before the error has passed to ``_run``.
            self._mapping, self._fault = ClockMapping(nominal), str(error)
            raise error
        if line is not None:
            self._frames.period_s = line.period_ns / NS
        self._fault = "" if line else f"{self.device.name}: finding its clock"
