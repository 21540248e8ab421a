"""Tools of the group mosaic."""
