"""Tools of the group ingest."""
