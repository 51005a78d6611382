"""Sensor types. Each is found through the entry-point group ``posor.sensors``."""
