"""The page: `georef serve`, on this machine only."""
