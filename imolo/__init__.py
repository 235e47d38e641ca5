"""Immediate motion generation using a lookup table of learned dynamics, on any backend that speaks LCM."""

__version__ = "0.1.0"
