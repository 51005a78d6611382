"""Judges the commissioning check on simulated arms: exchanged plugs, signs, wrong files, and arms without a fault."""
