"""Many trials: run, kept, compared."""
