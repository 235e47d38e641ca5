"""The scene in the browser: robot, ball, markers, predicted path and target of each session."""

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
import yourdfpy
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial
from viser.extras import ViserUrdf

from imolo.config.simulation import BallConfig
from imolo.contracts.robot import Body
from imolo.messaging import channels
from imolo.view.sessions import Moment
from imolo_msgs import marker_t, mocap_frame_t, plan_t, truth_ball_t, truth_robot_t

logger = logging.getLogger(__name__)

Color = tuple[int, int, int]

BALL_COLOR: Color = (225, 60, 40)
MARKER_COLOR: Color = (60, 120, 220)
TARGET_COLOR: Color = (30, 160, 80)
BOX_COLOR: Color = (196, 178, 150)
MARKER_SIZE = 0.025  # [m]
TARGET_SIZE = 0.03  # [m] three cells of the paper's grid, so that it can be seen
PATH_WIDTH = 0.008  # [m]
GROUND_LIGHT: Color = (150, 145, 140)
SKY_INTENSITY = 2.5
CAMERA = (1.9, -3.4, 1.5)  # [m]
LOOK_AT = (0.85, 0.0, 1.0)  # [m]
FIELD_OF_VIEW = 0.85  # [rad] vertical
GHOST = 0.4  # opacity of all sessions but the first


def prepare_scene(server: viser.ViserServer, body: Body) -> None:
    """Add what never moves: floor, boxes, light and the first view."""
    server.scene.set_up_direction("+z")
    # The default light is a picture from the network; a view must work without one.
    server.scene.configure_environment_map(None)
    server.scene.add_light_hemisphere("/sky", ground_color=GROUND_LIGHT, intensity=SKY_INTENSITY)
    server.scene.add_grid("/floor", width=10.0, height=6.0, cell_size=0.25, section_size=1.0, position=(1.0, 0.0, 0.0))
    for number, box in enumerate(body.boxes):
        x, y, z = box.half_extents
        server.scene.add_box(f"/box_{number}", BOX_COLOR, (2.0 * x, 2.0 * y, 2.0 * z), position=box.center)
    server.initial_camera.position = CAMERA
    server.initial_camera.look_at = LOOK_AT
    server.initial_camera.fov = FIELD_OF_VIEW
    server.initial_camera.up = (0.0, 0.0, 1.0)


class SessionScene:
    """One session; several lie over each other, each in a colour of its own, all but the first translucent."""

    def __init__(self, server: viser.ViserServer, body: Body, number: int, color: str | None) -> None:
        """Add the robot and its ball.

        Args:
            server: Where to draw.
            body: Of the robot.
            number: Of the session among those shown.
            color: Of the session; None where it is the only one, which keeps the colours of the model.
        """
        self._scene = server.scene
        self._root = f"/session_{number}"
        self._alone = color is None
        self._color = BALL_COLOR if color is None else _rgb(color)
        opacity = None if number == 0 else GHOST
        self._shown: dict[str, Any] = {}
        self._trunk = self._scene.add_frame(f"{self._root}/robot", show_axes=False)
        tint = None if self._alone else tuple(part / 255.0 for part in self._color) + ((GHOST,) if opacity else ())
        model = _matt(yourdfpy.URDF.load(str(body.urdf)))
        self._robot = ViserUrdf(
            server,
            model,
            root_node_name=f"{self._root}/robot",
            mesh_color_override=tint,
        )
        self._body, self._warned = body, False
        self._order = [body.joint_names.index(joint) for joint in self._robot.get_actuated_joint_names()]
        radius = BallConfig().radius
        self._ball = self._scene.add_icosphere(
            f"{self._root}/ball", radius, self._color, opacity=opacity, visible=False
        )
        self._target = self._scene.add_box(
            f"{self._root}/target",
            TARGET_COLOR if self._alone else self._color,
            (TARGET_SIZE,) * 3,
            opacity=0.7,
            visible=False,
        )

    def show(self, moment: Moment) -> None:
        """Draw what has changed since the last moment."""
        draws = {
            channels.TRUTH_ROBOT: self._show_robot,
            channels.TRUTH_BALL: self._show_ball,
            channels.MOCAP: self._show_markers,
            channels.PLAN: self._show_plan,
        }
        for channel, draw in draws.items():
            message = moment.get(channel)
            if message is not self._shown.get(channel):
                self._shown[channel] = message
                draw(message)

    def _show_robot(self, truth: truth_robot_t | None) -> None:
        if truth is None:
            return
        if len(truth.joint_angle) != len(self._body.joint_names):
            if not self._warned:
                self._warned = True
                numbers = len(truth.joint_angle), self._body.name, len(self._body.joint_names)
                logger.warning("a robot of %d joints is not shown; %s has %d", *numbers)
            return
        self._trunk.position = np.array(truth.base_position)
        self._trunk.wxyz = np.array(truth.base_quaternion)
        self._robot.update_cfg(np.array(truth.joint_angle)[self._order])

    def _show_ball(self, truth: truth_ball_t | None) -> None:
        self._ball.visible = truth is not None
        if truth is not None:
            self._ball.position = np.array(truth.true_ball_position)

    def _show_markers(self, frame: mocap_frame_t | None) -> None:
        markers = [] if frame is None else list(frame.markers)
        known, ball = (MARKER_COLOR, BALL_COLOR) if self._alone else (self._color, self._color)
        colors = [ball if marker.marker_id == marker_t.UNLABELLED else known for marker in markers]
        self._scene.add_point_cloud(
            f"{self._root}/markers",
            np.array([marker.marker_position for marker in markers], dtype=np.float32).reshape(-1, 3),
            np.array(colors, dtype=np.uint8).reshape(-1, 3),
            point_size=MARKER_SIZE,
            point_shape="circle",
            precision="float32",
        )

    def _show_plan(self, plan: plan_t | None) -> None:
        path = np.zeros((0, 3)) if plan is None else np.array(plan.predicted_position).reshape(-1, 3)
        self._scene.add_line_segments(
            f"{self._root}/prediction",
            _segments(path),
            (240, 160, 30) if self._alone else self._color,
            thickness=PATH_WIDTH,
        )
        started = plan is not None and plan.plan_onset_utime > 0
        self._target.visible = started
        if started:
            self._target.position = np.array(plan.target_position)  # type: ignore[union-attr]


def _matt(model: yourdfpy.URDF) -> yourdfpy.URDF:
    """Give the shapes the colours of the URDF as paint; by default they would be metal, black without surroundings."""
    for shape in model.scene.geometry.values():
        color = shape.visual.main_color
        shape.visual = TextureVisuals(
            material=PBRMaterial(
                baseColorFactor=color,
                metallicFactor=0.0,
                roughnessFactor=0.8,
                alphaMode="OPAQUE" if color[3] == 255 else "BLEND",
            )
        )
    return model


def _segments(path: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the pieces of a path that are above the floor, shape (N, 2, 3)."""
    pieces = np.stack([path[:-1], path[1:]], axis=1) if len(path) > 1 else np.zeros((0, 2, 3))
    return pieces[(pieces[:, :, 2] > 0.0).all(axis=1)].astype(np.float32)


def _rgb(color: str) -> Color:
    red, green, blue = (int(color[start : start + 2], 16) for start in (1, 3, 5))
    return red, green, blue


def show_all(scenes: Sequence[SessionScene], moments: Sequence[Moment]) -> None:
    """Draw one moment of every session."""
    for scene, moment in zip(scenes, moments, strict=True):
        scene.show(moment)
