"""What changed between two mosaics of one site."""
