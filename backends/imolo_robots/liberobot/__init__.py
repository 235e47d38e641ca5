"""Liberobot, the pneumatic humanoid of the paper."""
