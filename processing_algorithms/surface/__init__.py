"""Tools of surfaces, profiles and volumes."""
