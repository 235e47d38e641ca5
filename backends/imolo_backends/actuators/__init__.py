"""What moves joints: air and motors."""
