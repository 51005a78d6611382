"""Simulated calibration campaigns: a POSOR that is not what its calibration says, and all that is recorded to tell."""
