# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of setup.cfg; a LazyProgram loads its program when it is called."""

from __future__ import annotations

from posor.lazy_program import LazyProgram

arm = LazyProgram("arm", "posor_bringup.arm_files_command")
bringup = LazyProgram("bringup", "posor_bringup.bringup")
calibrate_arm = LazyProgram("calibrate_arm", "posor_bringup.calibrate_arm_command")
health = LazyProgram("health", "posor_bringup.health_command")
encoders = LazyProgram("encoders", "posor_bringup.encoders_command")
view = LazyProgram("view", "posor_bringup.view_command")
statement = LazyProgram("statement", "posor_bringup.statement_command")
iso9283 = LazyProgram("iso9283", "posor_bringup.iso9283_command")
commission = LazyProgram("commission", "posor_bringup.commission_command")
posor = LazyProgram("posor", "posor_bringup.posor_command")
