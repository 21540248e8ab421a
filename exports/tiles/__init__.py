"""Maps as pictures: COG and web tiles."""
