"""Benchmark of the stack: latency, lost ticks, processor time, and speed of offline processing."""
