"""Harness for the tests of all packages: real programs in own processes, and a node that watches the graph."""
