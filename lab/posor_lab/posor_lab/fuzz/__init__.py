"""Damaged messages and files: results of the programs for damaged bytes."""
