"""What plug-ins promise, and how they are found."""
