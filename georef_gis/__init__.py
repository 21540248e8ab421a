"""Georef GIS: from UAV photos to orthos, mosaics and measurements with their uncertainty."""

import logging

__version__ = "0.1.0"

logging.getLogger(__name__).addHandler(logging.NullHandler())
