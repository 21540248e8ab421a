"""Positions, lengths and their uncertainty."""
