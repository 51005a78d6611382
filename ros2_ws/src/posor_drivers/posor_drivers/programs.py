"""The programs of this package, as setup.py names them: each is loaded when it is called."""

from __future__ import annotations

from posor_estimator.starting import Starter

driver_node = Starter("driver_node", "posor_drivers.driver_node")
record = Starter("record", "posor_drivers.record")
