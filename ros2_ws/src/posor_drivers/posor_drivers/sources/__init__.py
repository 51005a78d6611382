"""Where a driver's scans come from. A source registers under the entry point group ``posor_drivers.sources``."""
