"""Shared parts of all nodes of the stack: parameters, lifecycle, diagnostics, quality of service and the main loop."""
