"""Poses and cameras for other programs."""
