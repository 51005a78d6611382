"""Replays the motion tests of 1985 through the nodes and compares them with the thesis."""
