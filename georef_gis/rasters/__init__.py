"""Reading rasters by window and writing tiled GeoTIFF."""
