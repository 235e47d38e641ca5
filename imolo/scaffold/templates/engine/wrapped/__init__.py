"""An engine for imolo."""
