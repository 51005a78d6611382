"""Mutations: the estimator's model is broken on purpose, and a check against the independent truth must notice."""
