"""Accuracy statement: check points, statistics, sentences."""
