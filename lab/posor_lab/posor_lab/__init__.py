"""Everything that judges the POSOR stack: 1985 comparison, campaigns, accuracy, budgets, benchmark."""
