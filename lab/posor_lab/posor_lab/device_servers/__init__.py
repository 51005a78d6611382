"""Counterparts of devices for tests: servers that speak their protocols over real sockets, with faults on demand."""
