"""Tools of the group measure."""
