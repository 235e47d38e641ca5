"""What a robot can be asked to do with a thrown ball."""
