"""Error budget: what the errors of a place are made of."""
