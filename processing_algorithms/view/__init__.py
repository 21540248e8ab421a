"""What a page shows of a project: facts, layers, tiles."""
