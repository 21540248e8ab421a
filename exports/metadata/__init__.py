"""Metadata beside the products, and STAC."""
