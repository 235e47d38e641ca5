"""Immediate motion generation using a lookup table of learned dynamics, on any backend that speaks LCM."""

from imolo.machine.caches import provide_caches

__version__ = "0.1.0"

provide_caches()
