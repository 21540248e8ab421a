"""The documentation as a site: chapters of ``docs/``, and a page for every command."""
