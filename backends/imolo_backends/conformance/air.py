"""Pneumatics and drag: the plant that every simulated backend shares."""

from imolo_backends.conformance.subject import SceneCheck

SCENES: tuple[SceneCheck, ...] = ()
