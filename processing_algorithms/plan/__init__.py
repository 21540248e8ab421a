"""Tool that plans a flight."""
