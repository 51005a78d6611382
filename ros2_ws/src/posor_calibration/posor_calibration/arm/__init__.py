"""Calibration of a whole arm from references of its endpoint: POSORs, beams, base and tool at once."""
