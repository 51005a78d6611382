"""The command line of calibration: ``calibrate PROCEDURE BAG``, ``list``, ``diff``, ``check``."""
