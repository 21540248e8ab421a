"""Tools of the group orient."""
