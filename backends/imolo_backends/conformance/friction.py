"""Friction: distance and direction of sliding, rolling, ramps, and what pairs of bodies get."""

from imolo_backends.conformance.subject import SceneCheck

SCENES: tuple[SceneCheck, ...] = ()
