"""Design calculators: each computes a part of a POSOR or of its structure from dimensions, in SI units."""
