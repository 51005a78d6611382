"""The error budgets of the thesis, computed cell by cell from the measurement model."""
