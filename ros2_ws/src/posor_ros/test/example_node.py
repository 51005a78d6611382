# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A node that tests start as a program: it prints each hook that runs, and fails in the hook named by a parameter."""

from __future__ import annotations

import sys
from typing import Annotated, Literal

from posor.errors import CalibrationError
from posor.node_parameters import NodeParameters
from posor.parameter_model import ChangeableAtRunTime
from posor_ros.diagnostics import Level
from posor_ros.lifecycle_node import PosorNode
from posor_ros.node_program import run_node
from pydantic import Field
from rcl_interfaces.msg import Log


class ExampleParameters(NodeParameters):
    fail: Literal["never", "configure", "late", "activate", "bug", "active bug"] = Field(
        default="never", description="where to fail"
    )
    gain: Annotated[float, Field(ge=0.0, le=5.0), ChangeableAtRunTime()] = Field(default=1.0, description="a gain")
    names: tuple[str, ...] = Field(default=(), description="names")
    count: Annotated[int, Field(ge=1, le=9)] = Field(default=2, description="a count")


class ExampleNode(PosorNode[ExampleParameters]):
    """An example."""

    NAME = "example"
    Parameters = ExampleParameters

    def configure(self) -> None:
        print("configure", flush=True)
        if self.parameters.fail == "configure":
            raise CalibrationError("is wrong", where="some.yaml", expected="a right one")
        if self.parameters.fail == "bug":
            raise KeyError("a bug")
        self.output = self.create_lifecycle_publisher(Log, "output", 10)
        self.add_cleanup(self.undo)
        if self.parameters.fail == "late":
            raise CalibrationError("is wrong", where="some.yaml", expected="a right one")
        self.status = self.diagnostics.add_status("work")
        self.refreshed = 0
        self.diagnostics.add_refresh(self.refresh)

    def refresh(self) -> None:
        self.refreshed += 1
        self.status.update({"refreshed": self.refreshed})

    def activate(self) -> None:
        print(f"activate, publisher active: {self.output.is_activated}", flush=True)
        if self.parameters.fail == "active bug":
            raise KeyError("a bug")
        if self.parameters.fail == "activate":
            raise CalibrationError("is wrong", where="some.yaml")
        self.status.report(Level.WARN, "first", {"number": 1, "flag": True, "real": 0.1})
        self.status.report(Level.OK, "second")
        self.status.report(Level.OK, "second", {"number": 2})
        self.status.report(Level.OK, "third")

    def deactivate(self) -> None:
        print(f"deactivate, publisher active: {self.output.is_activated}", flush=True)

    def undo(self) -> None:
        print("cleanup", flush=True)
        self.destroy_lifecycle_publisher(self.output)


if __name__ == "__main__":
    sys.exit(run_node(ExampleNode))
