"""Articulated bodies: torques, pendulums, and the robot as a mechanism."""

from imolo_backends.conformance.subject import SceneCheck

SCENES: tuple[SceneCheck, ...] = ()
