"""Service `measure` of the page."""
