"""Numerical core: the measurement model, its inversion and the kinematic chain. Imports no ROS."""
