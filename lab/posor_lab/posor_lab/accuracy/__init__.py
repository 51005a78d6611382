"""Accuracy runs: how well the estimator inverts the model, states its uncertainty, and notices faults."""
