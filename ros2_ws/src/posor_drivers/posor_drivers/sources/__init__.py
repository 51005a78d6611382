"""Sources of raw scans; ``source.py`` explains how to add one."""
