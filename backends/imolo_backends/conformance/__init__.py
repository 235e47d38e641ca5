"""The conformance kit: scenes with closed-form truth that every engine is put through.

Each module holds the scenes of one group, each scene a function of the `Subject` that yields measurements. An engine's
author runs them by `imolo check ENGINE`, or in pytest by `imolo.conformance.testing.parametrize_checks`.
"""

from imolo.conformance import Check
from imolo.contracts.engine import Engine, EngineOptions
from imolo_backends.conformance import collisions, contact_report, contract, free_motion, friction, joints, push_off
from imolo_backends.conformance.subject import Subject, bind

SCENES = (
    *contract.SCENES,
    *free_motion.SCENES,
    *joints.SCENES,
    *collisions.SCENES,
    *contact_report.SCENES,
    *friction.SCENES,
    *push_off.SCENES,
)


def engine_checks(engine: type[Engine], options: EngineOptions) -> tuple[Check, ...]:
    """Return all checks of an engine under these options."""
    subject = Subject(engine, options)
    return tuple(bind(scene, subject) for scene in SCENES)
