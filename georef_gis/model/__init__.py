"""Values that travel between the stages: frozen, checked once, no file access."""
