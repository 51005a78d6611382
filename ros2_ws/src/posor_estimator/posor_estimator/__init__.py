"""Nodes: posor_node, chain_node, and the program that composes nodes in one process."""
