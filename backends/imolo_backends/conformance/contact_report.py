"""What an engine tells of the ball's contacts, with every shape that the ball can touch."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imolo.conformance import Measurement
from imolo.contracts.engine import Array, Ball, BoxShape, Scene
from imolo.contracts.urdf import read_urdf
from imolo_backends.conformance.bodies import (
    BALL_RADIUS,
    BLOCK,
    CONTACT_TIMESTEP,
    ROBOT,
    WEIGHTLESS,
    ball_scene,
    hanging_links,
    hanging_robot,
    moved,
    solid_ball,
)
from imolo_backends.conformance.subject import SceneCheck, Subject


def _thrown_at(center: Array, reach: float, outwards: Array) -> Ball:
    """Return a ball that flies inwards to a centre [m] that lies this far [m] below its body's surface."""
    place = moved(center, *((reach + BALL_RADIUS + 0.05) * outwards))
    return solid_ball(place, moved(-3.0 * outwards, 0.0, 0.0, 0.0))


def _touchable() -> dict[str, list[Scene]]:
    """Return, by the name of each body that the ball can touch, scenes in which it meets each of its shapes."""
    boxes = (BLOCK, BoxShape("step", (1.5, 0.2, 0.1), (0.3, 0.2, 0.1)))
    front, _, up = np.eye(3)
    balls = {"floor": _thrown_at(np.array([0.0, 3.0, 0.0]), 0.0, up)}
    balls |= {box.name: _thrown_at(np.array(box.center), box.half_extents[2], up) for box in boxes}
    scenes = {name: [ball_scene(ball, boxes=boxes, gravity=WEIGHTLESS)] for name, ball in balls.items()}
    poses = hanging_links()
    for name, link in read_urdf(ROBOT).links.items():
        # The first of two from the front, the second, which it may hide, from behind.
        for shape, outwards in zip(link.collisions, (front, -front), strict=False):
            position, rotation = poses[name]
            reach = shape.size[0] if shape.kind == "sphere" else 0.5 * shape.size[0]
            ball = _thrown_at(position + rotation @ shape.position, reach, outwards)
            scenes.setdefault(name, []).append(hanging_robot(ball=ball))
    return scenes


@dataclass
class _Report:
    """What is told of contacts, beside what the ball says."""

    told: float = 0.0  # [N s]
    gained: float = 0.0  # [N s]
    aside: float = 0.0  # [m]
    others: int = 0
    twice: int = 0
    lost: int = 0

    def add(self, subject: Subject, scene: Scene, name: str) -> None:
        """Run a scene, read at its end and at every step, in which the ball meets the body of this name."""
        duration = 0.03
        with subject.run(scene) as run:
            state = run.advance(duration)
        with subject.run(scene) as run:
            read = sum(len(now.ball_contacts) for now in run.states(duration, CONTACT_TIMESTEP))
        contacts, velocity = state.ball_contacts, np.array(scene.ball.velocity)
        heading = velocity / np.linalg.norm(velocity)
        gained = scene.ball.mass * float(heading @ (velocity - state.ball_velocity))
        told = sum(contact.force for contact in contacts) * CONTACT_TIMESTEP
        paths = [c.force * np.cross(heading, c.position - scene.ball.position) for c in contacts]
        aside = float(np.linalg.norm(paths, axis=-1).sum()) * CONTACT_TIMESTEP / told if told else np.nan
        self.told, self.gained = self.told + told, self.gained + gained
        self.aside = float(np.maximum(self.aside, aside))
        self.others += sum(contact.other != name for contact in contacts)
        self.twice += len(contacts) - len({contact.time for contact in contacts})
        self.lost += abs(read - len(contacts))


def contact_report(subject: Subject) -> Iterator[Measurement]:
    """Every contact of the ball, whatever it touches, is told, once, where it is, and with all of its force."""
    reports = []
    for name, scenes in _touchable().items():
        report = _Report()
        for scene in scenes:
            report.add(subject, scene, name)
        reports.append(report)
        # Limbs turn away a little, and the normal with them.
        turn = 0.02 if scenes[0].joint_names else 0.0  # [rad]
        yield Measurement(
            f"momentum told over gained, {name}", "", 1.0, report.told / report.gained, 1e-5 + 0.5 * turn**2,
            "single precision; cosine of the limb's turn",
        )  # fmt: skip
        yield Measurement(
            f"contact told aside of the ball's path, {name}", "m", 0.0, report.aside, 1e-6 + turn * BALL_RADIUS,
            "mean over force; single precision; sine of the limb's turn",
        )  # fmt: skip
    for quantity, count in (
        ("contacts told under other names", sum(report.others for report in reports)),
        ("contacts told twice a step", sum(report.twice for report in reports)),
        ("contacts lost between two reads", sum(report.lost for report in reports)),
    ):
        yield Measurement(quantity, "", 0.0, count, 0.0, "a count")


SCENES: tuple[SceneCheck, ...] = (contact_report,)
