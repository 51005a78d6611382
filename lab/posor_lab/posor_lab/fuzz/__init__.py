"""Damaged messages and files: what the programs make of bytes that nobody meant."""
