"""The measurement model: one file per physical effect, each formula with its derivatives."""
