"""One picture out of many photos."""
