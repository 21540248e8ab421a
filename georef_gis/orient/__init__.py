"""The pose of every photo."""
