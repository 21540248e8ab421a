"""Surfaces with their sigma, profiles and volumes."""
