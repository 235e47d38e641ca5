"""What `Engine` promises: clock, frames, order, copies, determinism."""

from imolo_backends.conformance.subject import SceneCheck

SCENES: tuple[SceneCheck, ...] = ()
