"""Clicks matched into the photos beside them."""
