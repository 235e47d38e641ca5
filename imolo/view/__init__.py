"""A browser view of running and recorded sessions."""
