"""Instruments: devices that deliver frames of channel values, their clocks, and scans made of their channels."""
