"""The report page of a project: what was made, how good it is, and where to look."""
