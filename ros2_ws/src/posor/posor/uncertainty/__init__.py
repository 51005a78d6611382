"""Error budgets of a POSOR: what the noise of each reading and each calibrated number do to the six freedoms."""
