"""A robot for imolo."""
