"""Calibration procedures: from recorded readings and a reference to parameters with their uncertainty. No ROS here."""
