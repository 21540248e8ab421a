"""The tool that compares two dates of a site."""
