"""Bags in bulk: many messages at a time, as arrays."""
