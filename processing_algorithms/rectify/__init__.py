"""Tools of the group rectify."""
