"""`georef batch`: many sites, each in a process of its own, and one table of them all."""
