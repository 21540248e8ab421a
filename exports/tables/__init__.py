"""Layers as tables of features: GeoPackage, GeoJSON, Shapefile and others."""
