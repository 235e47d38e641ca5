"""A session of several programs on one LCM network: backend, planner and recorder, each its own process."""
