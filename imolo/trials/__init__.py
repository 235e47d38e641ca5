"""One trial: how it is run, and what its log says."""
