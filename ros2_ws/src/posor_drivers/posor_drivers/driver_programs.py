# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the console scripts of this package; each loads its program when it is called."""

from __future__ import annotations

from posor.lazy_program import LazyProgram

driver_node = LazyProgram("driver_node", "posor_drivers.driver_node", is_live=True)
import_table = LazyProgram("import", "posor_drivers.import_command")
instruments = LazyProgram("instruments", "posor_drivers.instruments.instruments_command")
record = LazyProgram("record", "posor_drivers.recorder", is_live=True)
