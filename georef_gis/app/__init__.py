"""Faces only, no geometry: command line and doctor."""
