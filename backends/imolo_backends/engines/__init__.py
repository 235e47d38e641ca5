"""One adapter per physics engine."""
