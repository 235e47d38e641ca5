"""Questions that take several campaigns."""
