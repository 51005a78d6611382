"""Trials of the instruments: servers of simulated devices, the real nodes, and the truth behind the servers."""
