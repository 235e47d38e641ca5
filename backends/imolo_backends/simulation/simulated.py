"""The simulated backend: one engine, the plant around it and the streams, stepped event by event."""

import heapq
import itertools
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of, create_task
from imolo.config.model import Model
from imolo.conformance import Check, Limitation
from imolo.contracts.backend import Backend, BackendPlugin
from imolo.contracts.engine import Array, Engine, EngineOptions, EngineState
from imolo.contracts.robot import Body
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import DivergenceError, MessageError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.commands import Commands
from imolo_backends.simulation.ball_air import BallAir
from imolo_backends.simulation.command_schedule import CommandSchedule
from imolo_backends.simulation.mocap import Mocap
from imolo_backends.simulation.start_up import check_start_up
from imolo_backends.simulation.stepping import stepping
from imolo_backends.simulation.streams import Streams
from imolo_msgs import actuator_command_t, trial_event_t

logger = logging.getLogger(__name__)

TOUCHDOWN_MARGIN = 0.002  # [m] above the floor at which a foot counts as landed


class SimulatedBackend:
    """Runs any engine with any robot and publishes the same streams for all of them.

    Time is counted in engine steps; whatever happens between them (a frame, a phase switch, the release of the ball)
    is an event at a step, so that the loop over the steps holds nothing but actuators and rigid bodies.

    Attributes:
        utime: Simulated time [µs].
    """

    def __init__(self, config: ExperimentConfig, engine: type[Engine], options: Model) -> None:
        """Prepare; nothing is loaded before `start`.

        Args:
            config: Everything around the engine.
            engine: Class of the engine.
            options: The engine's own options.
        """
        self._name = config.backend.name
        self._robot = config.robot.name
        self._config = config.simulation
        self._body = body_of(config.robot)
        self._config.actuators.check_joints(self._body.joints)
        self._task = create_task(config)
        self._engine_class = engine
        self._options = options
        body = self._body
        self._touching = frozenset(effector.link for effector in body.effectors)
        self._links = frozenset(body.link_names)
        self._feet = [(body.link_names.index(foot.link), foot) for foot in body.feet]
        self._step = 0
        self.utime = 0
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._happened: set[EventName] = set()
        self._commanded: tuple[object, ...] = ()

    def start(self, bus: Bus, trial: Trial) -> None:
        """Load the scene, bring the robot to its ready pose and join the bus."""
        config = self._config
        self._bus = bus
        self._trial = trial
        body, task = self._body, self._task
        throw = task.throw(trial)
        rng = trial.generator("disturbance")
        ball = replace(task.ball, position=tuple(throw.position.tolist()))
        check_start_up(self._engine_class, self._options, config.timestep, body)
        drawn = config.actuators.draw(config.disturbance, rng)
        offset = draw_joint_offset(body, config.disturbance.joint_angle, rng)
        contact = config.contact
        scene = body.scene(
            ball, config.timestep, contact.friction, contact.restitution, offset, contact.robot_restitution
        )
        self._engine = self._engine_class(scene, self._options)
        self._actuators = config.actuators.create(
            body.joint_limits, np.array(scene.joint_angle), config.timestep, drawn
        )
        self._channels = config.actuators.channels
        self._air = BallAir(task.drag(), throw.lift)
        self._air.force[:] = 0.0 - ball.mass * np.array(scene.gravity)  # holds the ball
        self._take_steps = stepping(self._engine, self._actuators, self._air)
        self._schedule = CommandSchedule(self._channels)
        self._mocap = Mocap(config.mocap, body, trial.generator("mocap"))
        noise, count = config.actuators.sensor_noise, len(self._channels)
        self._streams = Streams(bus, body, noise, count, trial.generator("pressure"))
        self._ball_mass = ball.mass
        self._released = False
        self._throw = throw
        self._state = self._engine.read()
        self._state_step = 0
        bus.subscribe(channels.ACTUATOR_COMMAND, self._on_command)
        self._every(config.sensor_rate, self._tell_sensors)
        self._every(config.truth_rate, self._tell_truth)
        self._every(config.mocap.rate, self._expose)
        if trial.kind is not TrialKind.TRAINING:
            self._at(throw.release_time, self._release)

    def advance(self, until_utime: int) -> None:
        """Simulate up to `until_utime` [µs], and to the end of the step it lies in.

        Raises:
            DivergenceError: The state is no longer finite.
        """
        end = math.ceil(until_utime * 1e-6 / self._config.timestep - 1e-6)
        while self._step < end:
            self._run(min(end, self._events[0][0]) - self._step)
            while self._events and self._events[0][0] <= self._step:
                heapq.heappop(self._events)[2]()

    def close(self) -> None:
        """Free the engine."""
        self._engine.close()

    def _run(self, steps: int) -> None:
        self._take_steps(steps, self._released)
        self._step += steps
        self.utime = round(self._step * self._config.timestep * 1e6)

    def _at(self, time: float, action: Callable[[], None]) -> None:
        step = max(math.ceil(time / self._config.timestep - 1e-6), self._step)
        heapq.heappush(self._events, (step, next(self._order), action))

    def _every(self, rate: float, action: Callable[[], None]) -> None:
        counter = itertools.count(1)

        def fire() -> None:
            action()
            self._at(next(counter) / rate, fire)

        self._at(next(counter) / rate, fire)

    def _release(self) -> None:
        # One step of force that leaves exactly the release velocity behind.
        self._air.force += self._ball_mass * self._throw.velocity / self._config.timestep
        self._run(1)
        self._released = True
        self._announce_once(
            EventName.THROW, self._throw.position, f"velocity {np.round(self._throw.velocity, 3).tolist()} m/s"
        )

    def _on_command(self, message: actuator_command_t) -> None:
        # Every frame is answered, mostly by what is in force.
        content = message.onset_utime, message.switch_utime, message.target
        if content == self._commanded:
            return
        try:
            commands = Commands.from_message(message, self._channels)
        except MessageError as error:
            logger.warning("refused a command at %d us: %s", message.utime, error)
            return
        self._commanded = content
        if self._schedule.accept(commands):
            self._follow_schedule()
            for change in self._schedule.changes_after(self.utime):
                self._at(change * 1e-6, self._follow_schedule)

    def _follow_schedule(self) -> None:
        self._actuators.target[:] = self._schedule.target(self.utime)
        late = self._schedule.time_since_onset(self.utime)
        if late is not None:
            self._announce_once(EventName.ONSET, np.zeros(3), f"{late} us after the commanded onset")

    def _tell_sensors(self) -> None:
        self._streams.tell_sensors(self.utime, self._actuators.measured())

    def _tell_truth(self) -> None:
        state = self._read()  # first, since it may announce what happened
        self._streams.tell_truth(self.utime, state)

    def _expose(self) -> None:
        self._mocap.expose(self.utime, self._read())
        self._at(self.utime * 1e-6 + self._config.mocap.latency, self._deliver)

    def _deliver(self) -> None:
        for frame in self._mocap.deliver(self.utime):
            self._bus.publish_raw(channels.MOCAP, frame)

    def _read(self) -> EngineState:
        if self._state_step == self._step:
            return self._state
        state = self._engine.read()
        self._state, self._state_step = state, self._step
        self._check_finite(state)
        for contact in state.ball_contacts:
            if contact.other in self._touching and EventName.BALL_LANDED not in self._happened:
                detail = f"{contact.other}, {contact.force:.1f} N"
                self._announce_once(EventName.TOUCH, contact.position, detail, contact.other, contact.time)
            elif contact.other not in self._links:
                detail = f"on {contact.other}"
                self._announce_once(EventName.BALL_LANDED, contact.position, detail, contact.other, contact.time)
        for index, foot in self._feet:
            if state.link_position[index, 2] < foot.height + TOUCHDOWN_MARGIN:
                self._announce_once(EventName.ROBOT_LANDED, state.link_position[index], foot.link, foot.link)
        return state

    def _check_finite(self, state: EngineState) -> None:
        joints = state.joint_angle.tolist() + state.joint_velocity.tolist()
        ball = state.ball_position.tolist() + state.ball_velocity.tolist()
        # Of so few numbers Python's sum is the fastest.
        if math.isfinite(sum(joints) + sum(ball) + sum(state.link_position.ravel().tolist())):
            return
        if not math.isfinite(sum(joints)):
            joint = int(np.argmin(np.isfinite(state.joint_angle) & np.isfinite(state.joint_velocity)))
            where = f"joint {self._body.joint_names[joint]}"
        elif not math.isfinite(state.link_position.sum()):
            where = f"link {self._body.link_names[0]}"
        else:
            where = "the ball"
        raise DivergenceError(
            f"{self._name}: {where} is no longer finite at {state.time:.4f} s of {self._trial.kind} trial "
            f"{self._trial.index}; try a smaller simulation.timestep than {self._config.timestep:g} s"
        )

    def _announce_once(
        self, event: EventName, position: Array, detail: str, touched: str = "", time: float | None = None
    ) -> None:
        if event in self._happened:
            return
        self._happened.add(event)
        message = trial_event_t()
        message.utime = self.utime if time is None else round(time * 1e6)
        message.trial = self._trial.index
        message.event = event.value
        message.robot = self._robot
        message.backend = self._name
        message.event_position = position.tolist()
        message.touched, message.detail = touched, detail
        self._bus.publish(channels.TRIAL, message)


def simulated_plugin(
    engine: type[Engine],
    options: type[EngineOptions],
    summary: str,
    limitations: Sequence[Limitation] = (),
    ingredients: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
) -> BackendPlugin:
    """Return what an engine's module offers as its entry point.

    Args:
        engine: The engine.
        options: Model of its options.
        summary: One line for `imolo backends`.
        limitations: What it cannot do under its default options, see `imolo check`.
        ingredients: What `imolo attribute` may exchange, see `BackendPlugin`.
    """

    def create(config: ExperimentConfig, chosen: Model) -> Backend:
        return SimulatedBackend(config, engine, chosen)

    def checks(chosen: Model) -> tuple[Check, ...]:
        from imolo_backends.conformance import engine_checks  # which trials do without

        return engine_checks(engine, options.model_validate(chosen.model_dump()))

    return BackendPlugin(summary, options, create, checks, tuple(limitations), ingredients or {}, engine=engine)


def draw_joint_offset(body: Body, deviation: float, rng: np.random.Generator) -> Array:
    """Draw by how much the ready pose of a trial is off [rad], shape (J,).

    Args:
        body: Whose joints are off inwards alone, since a ready pose may rest on their stops.
        deviation: Standard deviation [rad].
        rng: Chance of this trial.
    """
    low, high = body.joint_limits.T
    ready = np.array(body.ready)
    inwards = np.where(high - ready < ready - low, -1.0, 1.0)
    offset: Array = inwards * np.abs(rng.normal(0.0, 1.0, len(ready))) * deviation
    return offset
