"""Tools of the group navigate."""
