"""The simulated backend: one engine, and all that surrounds it."""
