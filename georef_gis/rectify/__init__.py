"""Footprints, grids and orthos."""
