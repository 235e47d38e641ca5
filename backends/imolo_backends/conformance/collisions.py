"""Impacts: momentum, restitution, and fast balls against thin plates."""

from imolo_backends.conformance.subject import SceneCheck

SCENES: tuple[SceneCheck, ...] = ()
