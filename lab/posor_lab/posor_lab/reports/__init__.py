"""Shared parts of the reports: findings, progress in the terminal, reception of a graph."""
