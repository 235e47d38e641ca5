"""IMoLo: motions, forward model, lookup table and planner (paper Secs. III to V)."""
