"""Assets: what their classes are, and the layers that hold them with their accuracy."""
