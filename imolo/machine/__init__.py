"""What the machine grants: packages and priority."""
