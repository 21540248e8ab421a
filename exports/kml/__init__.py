"""Google Earth: KML and KMZ."""
