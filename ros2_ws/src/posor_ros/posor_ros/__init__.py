"""What every node of the stack shares: parameters, lifecycle, diagnostics, quality of service and the main loop."""
