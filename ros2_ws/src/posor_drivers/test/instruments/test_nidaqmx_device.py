# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``nidaqmx`` without NI's driver: it names what is missing; nothing else can be tried here."""

from __future__ import annotations

import pytest
from posor_drivers.instruments.device import Channel, DeviceError
from posor_drivers.instruments.nidaqmx_device import NiDevice, NiSettings
from pydantic import ValidationError


def settings(**changes: object) -> NiSettings:
    units = {"gap1": "V", "source": "1", "gap2": "V"}
    return NiSettings.model_validate({"kind": "nidaqmx", **NiDevice.starting_settings(units), **changes})


def test_without_package_or_driver_the_device_names_what_is_missing() -> None:
    device = NiDevice("daq", settings())
    with pytest.raises(DeviceError, match=r"daq: .*nidaqmx"):
        device.connect(1.0)
    device.close()


def test_settings_name_inputs_and_channels() -> None:
    device = NiDevice("daq", settings())
    assert device.channels == [Channel("gap1", "V"), Channel("gap2", "V")]
    assert device.address == "Dev1/ai0, Dev1/ai1"
    with pytest.raises(ValidationError, match="more than 0"):
        settings(rate={"value": 0.0, "unit": "Hz"})
