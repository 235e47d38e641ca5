"""The planner: from a mocap frame to commands, by the lookup table (Sec. IV, Fig. 3)."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.ball.model import BallModel
from imolo.ball.tracker import BallEstimate, BallTracker, BallTrackerConfig, made_up_flight
from imolo.config.model import Model, NonNegative, Positive
from imolo.contracts.trial import EventName
from imolo.errors import TableFileError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.commands import Commands, to_microseconds
from imolo.method.hit_choice import HitChooser, HitConfig
from imolo.method.hit_kernel import BallPath
from imolo.method.motion import MotionTemplate, Theta
from imolo.method.table import Executed, LookupTable
from imolo_msgs import mocap_frame_t, plan_t, trial_event_t

Array = NDArray[np.float64]

NEVER = 2**63 - 1  # [us]
NOT_KNOWN = -1.0  # [-] probability of a hit that the choice does not work out


class PlannerConfig(Model):
    """How the planner decides."""

    lead_time: NonNegative = Field(
        0.0083,
        description="exposure of a frame to the onset it may command [s], assumed: one frame",
    )
    horizon: Positive = Field(0.80, description="how far ahead the ball is predicted [s]")
    observation_time: NonNegative = Field(
        0.0, description="least time between the detection of the ball and the onset [s]; the paper names none"
    )
    choice: Literal["first", "probability"] = Field(
        "first",
        description="which motion: of the first point of the path that has one, Sec. IV-A, or the one that most "
        "probably hits, see docs/choice.md",
    )
    hit: HitConfig = HitConfig()
    update: bool = Field(True, description="whether commands are updated after the onset, Sec. IV-B3")


class PlanState(IntEnum):
    """What a `plan_t` says of itself."""

    WAITING = plan_t.WAITING
    TRACKING = plan_t.TRACKING
    STARTED = plan_t.STARTED
    UPDATED = plan_t.UPDATED
    KEPT = plan_t.KEPT


@dataclass(frozen=True)
class Decision:
    """A motion that has been decided on.

    Attributes:
        theta: Its parameter.
        commands: Its U.
        target: Grid point the hand is to reach [m], shape (3,).
        hit_utime: When it is to be there [µs].
        probability: Of a hit [-]; -1 where the choice does not work it out.
        side: 1 for the effector that was learned, -1 for the mirrored one.
    """

    theta: Theta
    commands: Commands
    target: Array
    hit_utime: int
    probability: float = NOT_KNOWN
    side: int = 1


class Planner:
    """Listens to MOCAP and TRIAL, answers every frame with PLAN, and with ACTUATOR_COMMAND while a motion runs.

    It knows neither engine nor backend: all it has is the table, the ball model and the messages.

    Attributes:
        commander: Instance of the program it runs in, said in every command; 0 where it is alone.
    """

    def __init__(
        self,
        table: LookupTable,
        ball_model: BallModel,
        config: PlannerConfig,
        tracker: BallTrackerConfig,
        on_decision: Callable[[float], object] | None = None,
    ) -> None:
        """Prepare for the first trial.

        Args:
            table: What the robot has learned of its motions.
            ball_model: What it has learned of flying balls.
            config: How to decide.
            tracker: How the ball is found and followed.
            on_decision: Told how long each answer took [s], mocap message in to commands out.
        """
        self._table = table
        self._template: MotionTemplate = table.template
        self._ball_model = ball_model
        self._config = config
        self._tracker = BallTracker(ball_model, tracker)
        self._steps = int(config.horizon / ball_model.time_step)
        self._step_times = ball_model.time_step * np.arange(1, self._steps + 1, dtype=np.float64)
        self._lead = to_microseconds(config.lead_time)
        self._observation = to_microseconds(config.observation_time)
        self._chooser: HitChooser | None = None
        if config.choice == "probability":
            self._chooser = HitChooser(table.swings, table.template, config.hit, ball_model.time_step)
        self._on_decision = on_decision
        self.commander = 0
        self._decision: Decision | None = None
        self._newest = -1
        self._detected = NEVER
        self._sequence = 0

    def attach(self, bus: Bus) -> None:
        """Join the bus."""
        self._bus = bus
        bus.subscribe(channels.TRIAL, self._on_trial)
        bus.subscribe(channels.MOCAP, self._on_frame)

    def warm_up(self) -> None:
        """Load and compile by a made-up flight what takes seconds at first: a robot in real time cannot wait for it."""
        bus = Bus()
        Planner(self._table, self._ball_model, self._config, self._tracker.config).attach(bus)
        for frame in made_up_flight():
            bus.publish(channels.MOCAP, frame)
        bus.drain()

    def _on_frame(self, frame: mocap_frame_t) -> None:
        begin = time.perf_counter()
        self._answer(frame)
        if self._on_decision is not None:
            self._on_decision(time.perf_counter() - begin)

    def _answer(self, frame: mocap_frame_t) -> None:
        if frame.utime <= self._newest:
            return
        self._newest = frame.utime
        estimate = self._tracker.update(frame)
        path = np.empty((0, 3))
        state = PlanState.WAITING
        if estimate is not None and estimate.in_flight:
            self._detected = min(self._detected, frame.utime)
            states = self._ball_model.predict(estimate.state, self._steps)
            path = states[:, :3]
            state = self._decide(frame.utime, estimate, states)
        elif self._decision is not None:
            state = PlanState.KEPT
        self._publish(frame, estimate, path, state)

    def _decide(self, utime: int, estimate: BallEstimate, states: Array) -> PlanState:
        """Start or update a motion if the table holds one for the predicted states; return the state of the plan."""
        before = self._decision
        if before is None:
            if utime < self._detected + self._observation:
                return PlanState.TRACKING
            onset, executed = utime + self._lead, None
        elif self._config.update:
            onset = before.commands.onset_utime
            executed = Executed(before.theta, (utime + self._lead - onset) * 1e-6)
        else:
            return PlanState.KEPT
        times = self._step_times + (utime - onset) * 1e-6
        if self._chooser is None:
            decision = self._first(states, times, onset, executed)
        else:
            decision = self._most_probable(self._chooser, estimate, states, times, onset, executed)
        if decision is None:
            return PlanState.TRACKING if before is None else PlanState.KEPT
        self._decision = decision
        if before is None:
            return PlanState.STARTED
        return PlanState.KEPT if decision.theta == before.theta else PlanState.UPDATED

    def _first(self, states: Array, times: Array, onset: int, executed: Executed | None) -> Decision | None:
        found = self._table.query_path(states[:, :3], times, executed)
        if found is None:
            return None
        commands = self._commands(found.theta, onset)
        target = self._table.position[found.tuple_index]
        return Decision(found.theta, commands, target, onset + to_microseconds(found.time))

    def _commands(self, theta: Theta, onset: int) -> Commands:
        before = self._decision
        if before is not None and (before.theta, before.commands.onset_utime) == (theta, onset):
            return before.commands
        return self._template.commands(theta, onset)

    def _most_probable(
        self,
        chooser: HitChooser,
        estimate: BallEstimate,
        states: Array,
        times: Array,
        onset: int,
        executed: Executed | None,
    ) -> Decision | None:
        near = chooser.reachable(states[:, :3])
        if not near.stop:
            return None
        covariance = self._ball_model.position_covariance(estimate.state, estimate.covariance, near.stop)[near]
        position, velocity = states[near, :3].copy(), states[near, 3:6].copy()
        ball = BallPath(times[near], position, velocity, covariance)
        found = chooser.start(ball) if executed is None else chooser.update(ball, *executed)
        if found is None:
            return None
        commands = self._commands(found.theta, onset)
        hit_utime = onset + to_microseconds(found.time)
        return Decision(found.theta, commands, found.position, hit_utime, found.probability, found.side)

    def _publish(self, frame: mocap_frame_t, estimate: BallEstimate | None, path: Array, state: PlanState) -> None:
        """Say what was decided: the command first, which the robot waits for, then the reasons."""
        decision = self._decision
        if decision is not None:
            self._sequence += 1
            self._bus.publish(
                channels.ACTUATOR_COMMAND, decision.commands.to_message(frame.utime, self._sequence, self.commander)
            )
        if estimate is not None and estimate.in_flight:
            self._bus.publish(channels.BALL_STATE, estimate.to_message())
        plan = plan_t()
        plan.utime = frame.utime
        plan.answered_frame = frame.frame_number
        plan.state = state
        plan.prediction_step = self._ball_model.time_step
        plan.num_predictions = len(path)
        plan.predicted_position = path.tolist()
        plan.hit_probability, plan.effector = NOT_KNOWN, -1
        if decision is not None:
            plan.num_parameters, plan.theta = len(decision.theta), list(decision.theta)
            plan.plan_onset_utime = decision.commands.onset_utime
            plan.hit_utime = decision.hit_utime
            plan.effector = 0 if decision.side > 0 else 1
            plan.hit_probability = decision.probability
            plan.target_position = decision.target.tolist()
        self._bus.publish(channels.PLAN, plan)

    def _on_trial(self, event: trial_event_t) -> None:
        if event.event != EventName.START:
            return
        if event.robot != self._table.robot:
            raise TableFileError(
                f"the table was learned on robot {self._table.robot!r}, but {event.robot!r} is on the bus; "
                f"train {event.robot!r} first"
            )
        self._reset()

    def _reset(self) -> None:
        self._tracker.reset()
        self._decision = None
        self._newest = -1
        self._detected = NEVER
        self._sequence = 0
