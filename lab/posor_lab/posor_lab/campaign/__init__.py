"""Simulated calibration campaigns of a POSOR whose true parameters differ from its calibration."""
