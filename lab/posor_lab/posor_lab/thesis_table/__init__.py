"""Printed numbers of the thesis beside the numbers that this project computes."""
