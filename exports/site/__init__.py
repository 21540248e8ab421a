"""All that a project has to export, gathered once, and its layers."""
