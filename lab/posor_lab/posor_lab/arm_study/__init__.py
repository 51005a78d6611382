"""A simulated arm, its endpoint errors, coverage and budget."""
