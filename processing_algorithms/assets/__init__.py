"""Tools of assets and work zones."""
