"""Simulation of an arm with POSORs: true poses and raw scans. This package imports no ROS."""
