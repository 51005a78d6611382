"""The shop floor: a simulated arm whose beams warm up."""
