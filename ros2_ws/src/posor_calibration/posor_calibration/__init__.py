"""Fit calibration parameters, with their uncertainties, to recorded scans and a reference. No ROS here."""
