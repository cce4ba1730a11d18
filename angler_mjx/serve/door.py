"""Loop of a served session: messages in, a step of the scene, messages out."""

import queue
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.runs.session.interface import Observation
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.serve import services, topics
from angler_mjx.serve.backends.interface import ACTION, Backend, Reply, Service
from angler_mjx.serve.commands import CommandInbox, Report
from angler_mjx.serve.goals import GoalServer
from angler_mjx.serve.messages import SceneMessages
from angler_mjx.serve.publisher import Publisher
from angler_mjx.serve.scene_view import list_facts, view_scene
from angler_mjx.teleop.loop import Watcher
from angler_mjx.teleop.opening import Drivable
from angler_mjx.teleop.pace import Overruns, RealTimePacer

type Pace = Literal["max", "step"] | float
"""Steps as fast as possible, by the client alone, or at a multiple of real time."""

REAL_REFUSAL = "real vehicles can be neither stopped in time nor reset"
"""Answer to services of simulated time."""
IDLE_S = 0.05
"""Wall time between looks at the request to stop, while the scene waits."""


class StopFlag(Protocol):
    """Request to stop."""

    @property
    def requested(self) -> bool:
        """Return whether to stop."""
        ...


@dataclass(frozen=True, kw_only=True)
class DoorSettings:
    """Settings of a served session."""

    pace: Pace = 1.0
    silence_s: float = 0.5
    """Time of the scene without a velocity after which a robot that is driven by velocities
    stops."""
    duration_s: float | None = None
    """Time of the scene; no limit if None."""
    can_reset: bool = True
    """Whether clients may reset the scene; a recording has one beginning."""
    is_real: bool = False
    """Whether the robots are outside the simulator: clients cannot stop, step or reset them, and no
    instruments are simulated."""


@dataclass(frozen=True, kw_only=True)
class DoorResult:
    """Result of a served session."""

    steps: int
    scene_s: float
    wall_s: float
    overruns: Overruns | None
    """Overruns; None without real time."""
    received: int
    """Messages with commands."""
    refused: int
    """Refused messages and goals."""
    sent: int
    """Messages handed to transports."""
    publisher_s: float
    """CPU time of the thread that publishes."""
    last: Observation
    broken: str = ""
    """Cause of an early end; empty otherwise."""


class Door:
    """Session with topics, services and actions; all its calls are made in one thread."""

    def __init__(
        self,
        session: Drivable,
        scenario: Scenario,
        backends: Sequence[Backend],
        settings: DoorSettings,
        report: Report,
        watchers: Sequence[Watcher] = (),
    ) -> None:
        """Declare everything, and publish the scene at its reset.

        Args:
            session: reset, with everything compiled.
            scenario: its scenario.
            backends: open transports.
            settings: settings.
            report: receives refusals and resets, for a person.
            watchers: called after every step.
        """
        self._session, self._settings, self._report = session, settings, report
        self._watchers = watchers
        self._events: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._inbox = CommandInbox(session, settings.silence_s, report)
        self._paused, self._seed, self._next_seed = False, scenario.seed, scenario.seed
        self._observation, self._steps = session.observe(), 0
        spec = scenario.sim_spec()
        messages = SceneMessages(
            session.robots,
            list_facts(scenario),
            dt_s=session.dt_s,
            density_kgpm3=spec.water.density_kgpm3,
            gravity_mps2=spec.water.gravity_mps2,
            has_instruments=not settings.is_real,
        )
        has_actions = [ACTION not in backend.missing for backend in backends]
        published = topics.list_published(session.robots, has_instruments=not settings.is_real)
        if any(has_actions):
            published += [
                topic for info in session.robots for topic in topics.action_topics(info).values()
            ]
        self._publisher = Publisher(messages, published, backends)
        self._goals = [
            GoalServer(session, i, self._inbox, partial(self._publish_action, i))
            for i in range(len(session.robots))
        ]
        self._publisher.reset(session.inside(), self._seed, view_scene(session, self._observation))
        self._publisher.flush()  # everything is compiled now
        for backend, is_offered in zip(backends, has_actions, strict=True):
            self._open(backend, has_actions=is_offered)

    def run(self, stop: StopFlag) -> DoorResult:
        """Serve until a request to stop, the duration, or the end of the session.

        Args:
            stop: request to stop, looked at before each step.
        """
        started_s, first_s, broken = time.perf_counter(), self._observation.time_s, ""
        pacer = self._make_pacer()
        overruns = pacer.overruns if pacer is not None else None
        try:
            while not stop.requested and not self._is_over(first_s):
                self._drain()
                if self._is_waiting:
                    self._wait_for_event()
                    pacer = self._make_pacer()
                    continue
                self._advance()
                if pacer is not None:
                    pacer.wait()
                    overruns = pacer.overruns
        except RunError as error:  # the session so far is kept
            broken = str(error)
        for goals in self._goals:
            goals.abort("the session ended", self._observation.time_s)
        self._publisher.close()
        return DoorResult(
            steps=self._steps,
            scene_s=self._observation.time_s - first_s,
            wall_s=time.perf_counter() - started_s,
            overruns=overruns,
            received=self._inbox.count("received"),
            refused=self._inbox.count("refused_messages"),
            sent=self._publisher.sent,
            publisher_s=self._publisher.busy_s,
            last=self._observation,
            broken=broken,
        )

    @property
    def _is_waiting(self) -> bool:
        return self._paused or self._settings.pace == "step"

    def _is_over(self, first_s: float) -> bool:
        duration_s = self._settings.duration_s
        if duration_s is None:
            return False
        # A thousandth of a period: times are sums in floating point.
        return self._observation.time_s - first_s > duration_s - 1e-3 * self._session.dt_s

    def _make_pacer(self) -> RealTimePacer | None:
        pace = self._settings.pace
        return None if isinstance(pace, str) else RealTimePacer(self._session.dt_s / pace)

    def _drain(self) -> None:
        while not self._events.empty():
            self._events.get()()

    def _wait_for_event(self) -> None:
        try:
            self._events.get(timeout=IDLE_S)()
        except queue.Empty:
            return

    def _advance(self) -> None:
        """Advance one control period, and publish the scene."""
        commands = self._inbox.take(self._observation.time_s)
        self._observation = self._session.step(commands)
        self._steps += 1
        for goals in self._goals:
            goals.update(self._observation)
        notes = self._inbox.describe()
        self._publisher.step(view_scene(self._session, self._observation), notes)
        for watcher in self._watchers:
            watcher.after(self._observation)

    def _open(self, backend: Backend, *, has_actions: bool) -> None:
        """Subscribe to the commands of all robots, and serve services and actions."""
        put = self._events.put
        for i, info in enumerate(self._session.robots):
            receivers = (
                (topics.velocity_topic(info), self._receive_twist),
                (topics.trajectory_topic(info), self._inbox.receive_trajectory),
                (topics.thruster_topic(info), self._inbox.receive_signals),
            )
            for topic, receive in receivers:
                backend.subscribe(
                    topic,
                    lambda data, i=i, receive=receive: put(partial(receive, i, data)),  # type: ignore[misc]
                )
        answers = (self._reset, self._pause, self._step, self._set_parameters)
        for service, answer in zip(topics.SERVICES, answers, strict=True):
            backend.serve(
                service,
                lambda data, reply, answer=answer: put(partial(answer, data, reply)),  # type: ignore[misc]
            )
        if has_actions:
            for i, info in enumerate(self._session.robots):
                self._open_action(backend, i, topics.action_services(info))

    def _open_action(self, backend: Backend, robot: int, served: dict[str, Service]) -> None:
        goals, put = self._goals[robot], self._events.put
        backend.serve(
            served["send_goal"],
            lambda data, reply: put(lambda: goals.send(data, reply, self._observation)),
        )
        backend.serve(
            served["cancel_goal"],
            lambda data, reply: put(lambda: goals.cancel(data, reply, self._observation)),
        )
        backend.serve(
            served["get_result"],
            lambda data, reply: put(lambda: goals.get_result(data, reply)),
        )

    def _publish_action(self, robot: int, name: str, message: ros.Message) -> None:
        topic = topics.action_topics(self._session.robots[robot])[name]
        self._publisher.publish(topic.name, message, self._observation.time_s)

    def _receive_twist(self, robot: int, data: bytes) -> None:
        self._inbox.receive_twist(robot, data, self._observation.time_s)

    def _reset(self, _: bytes, reply: Reply) -> None:
        if self._settings.is_real:
            reply(services.encode_trigger(False, REAL_REFUSAL))
            return
        if not self._settings.can_reset:
            reply(services.encode_trigger(False, "a recorded session cannot be reset"))
            return
        for goals in self._goals:
            goals.abort("the scene was reset", self._observation.time_s)
        self._inbox.reset()
        self._seed = self._next_seed
        self._observation = self._session.reset(self._seed)
        view = view_scene(self._session, self._observation)
        self._publisher.reset(self._session.inside(), self._seed, view)
        self._publisher.flush()
        self._report(f"reset, seed {self._seed}")
        reply(services.encode_trigger(True, f"seed {self._seed}"))

    def _pause(self, data: bytes, reply: Reply) -> None:
        if self._settings.is_real:
            reply(services.encode_trigger(False, REAL_REFUSAL))
            return
        try:
            self._paused = services.decode_pause(data)
        except ConfigError as error:
            reply(services.encode_trigger(False, str(error)))
            return
        self._publisher.flush()
        reply(services.encode_trigger(True, "paused" if self._paused else "running"))

    def _step(self, _: bytes, reply: Reply) -> None:
        """Advance one step; everything is published before the answer."""
        if not self._is_waiting:
            reply(services.encode_trigger(False, "the scene runs by itself; pause it first"))
            return
        self._advance()
        self._publisher.flush()
        reply(services.encode_trigger(True, f"{self._observation.time_s:.9g} s"))

    def _set_parameters(self, data: bytes, reply: Reply) -> None:
        answer = services.answer_parameters(data)
        if answer.seed is not None:
            self._next_seed = answer.seed
        reply(answer.data)
