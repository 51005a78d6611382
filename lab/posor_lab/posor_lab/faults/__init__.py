"""Fault table: injects faults into nodes and estimator, counts wrong poses that are published as valid."""
