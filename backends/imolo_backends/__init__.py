"""Simulated bodies: engines and the plant around them."""
