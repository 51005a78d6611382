"""Drivers of POSOR electronics: where raw scans come from, and where they are recorded."""
