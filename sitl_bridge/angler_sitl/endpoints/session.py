"""Session over vehicles that somebody else started, with the commands and plans of any session.

The scenario describes the water that the vehicles are in: obstacles and goals judge where they
are estimated to be. There is no truth: observations have none, and recordings hold the estimate.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.files import JsonTable
from angler_mjx.frames import GeodeticOrigin
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session import robot_checks
from angler_mjx.runs.session.batch_session import DEFAULT_POINTS, DEFAULT_START_TOLERANCE
from angler_mjx.runs.session.interface import Observation, SessionCommand
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.world.environment import region_corners
from angler_sitl.autopilot_session import AutopilotSession
from angler_sitl.endpoints.addresses import list_addresses
from angler_sitl.endpoints.connection import locate_fleet, open_fleet
from angler_sitl.endpoints.guarded_sender import GuardedSender
from angler_sitl.endpoints.limits import ARM_MARGIN_M, DEFAULT_SPEED_MPS, Fence, SetpointGuard
from angler_sitl.endpoints.losses import (
    EndAction,
    LossKind,
    LossLimits,
    command_action,
    find_loss,
    is_followed,
    measure_blindness,
)
from angler_sitl.endpoints.vehicles import VehicleFleet, VehicleReport
from angler_sitl.scene.scenario_options import select_scenario
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering import levels

STALL_S = 0.5
"""Time without a step after which new positions are waited for."""
REFRESH_TIMEOUT_S = 5.0
"""Time limit of new positions before arming."""
ACTION_S = 2.0
"""Time for which the action of a loss is repeated."""


class LossError(RunError):
    """Loss of a vehicle, which ends the session.

    Attributes:
        kind: name of the outcome.
    """

    def __init__(self, kind: LossKind, text: str) -> None:
        """Say what was lost and what was commanded."""
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True, kw_only=True)
class EndpointSettings:
    """Vehicles and limits of an `EndpointSession`."""

    endpoints: Sequence[str]
    """Connection strings: one for each robot, or one for all; see `angler_sitl.wire.endpoint`."""
    sysids: Sequence[int] = ()
    """System number of each robot; see `angler_sitl.endpoints.addresses.list_addresses`."""
    max_speed_mps: float = DEFAULT_SPEED_MPS
    """Max speed of targets."""
    fence: Fence | None = None
    """Box [m] in W that targets stay in; that of the scenario's world if None."""
    losses: LossLimits = field(default_factory=LossLimits)
    """Times [s] after which a link or a position counts as lost."""
    at_end: EndAction = "hold"
    """Action of flying vehicles after a loss, and at the end of the session: ``hold``, ``surface``
    or ``disarm``."""
    origin: GeodeticOrigin | None = None
    """Position of W's origin on the globe; that of the first vehicle's filter if None."""


class EndpointSession(AutopilotSession[VehicleFleet]):
    """`Session` over vehicles behind MAVLink endpoints, on the wall clock; a context manager.

    Commands, observations and shapes are those of `Session`: lengths in m in W (x east, y north, z
    up), velocities in F. There is no truth: positions are the autopilots' estimates.

    Nothing is armed before `arm`. Armed robots stay where they are until they receive commands, or
    `resume_plan`. A step waits for the end of its control period; the caller must go on stepping:
    a caller that stops is a lost ground station to the vehicles. See `docs/how_to/real_vehicle.md`.

    Attributes:
        settings: vehicles and limits.
        outcomes: outcome of each robot by its name: ``flown``, ``not_flown``, or the kind of a
            loss; empty before the end.
        end_note: text on the action that was commanded at the end, and its confirmation.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        settings: EndpointSettings,
        *,
        world: int = 0,
        robots: int | None = None,
        logs: Path | None = None,
        points: int = DEFAULT_POINTS,
        start_tolerance: float = DEFAULT_START_TOLERANCE,
        tolerances: Tolerances | None = None,
    ) -> None:
        """Find the vehicles, compile the scene, and wait for positions.

        Args:
            scenario: the scenario, its name, or its file.
            settings: vehicles and limits.
            world: index of the world in the scenario.
            robots: number of robots; the scenario's if left out.
            logs: folder of telemetry logs; none are kept if left out.
            points: max number of points of a JointTrajectory.
            start_tolerance: max distance from a robot to the start of a path, m and rad.
            tolerances: tolerances of JointTrajectories for x, y, z and yaw; those of `paths` if
                left out.

        Raises:
            ConfigError: no such world, endpoint or limit, or a vehicle with joints.
            RunError: nothing is heard of a vehicle, it is no ArduSub, or it has no position.
        """
        if world < 0:
            raise ConfigError(f"world = {world}: worlds are counted from 0")
        selected = select_scenario(scenario, robots)
        for entry in selected.fleet:
            if library.load_vehicle(entry.vehicle).joints:
                raise ConfigError(f"vehicle {entry.vehicle}: joints are not commanded by MAVLink")
        addresses = list_addresses(settings.endpoints, settings.sysids, len(selected.members()))
        SetpointGuard(Fence(lower_m=(0, 0, 0), upper_m=(1, 1, 1)), settings.max_speed_mps)
        self.settings, self.outcomes, self.end_note = settings, dict[str, str](), ""
        # Before compiling, which takes a minute.
        fleet = open_fleet(addresses, dt_s=selected.time.control_dt_s, logs=logs)
        try:
            scene = AutopilotScene(selected, world=world)
            scene.moored = False
            fence = settings.fence or _find_fence(scene)
            guards = [SetpointGuard(fence, settings.max_speed_mps) for _ in addresses]
            self._guarded_sender = GuardedSender(
                levels.build_level_spec("guided", scene.simulator.spec), guards
            )
            super().__init__(
                selected,
                scene,
                self._guarded_sender,
                level="guided",
                points=points,
                start_tolerance=start_tolerance,
                tolerances=tolerances,
                use_truth=False,
            )
            self._load_facts()
            locate_fleet(fleet, settings.origin)
            self._autopilots, self._fleet = fleet, fleet
            self._was_guided = [False] * len(addresses)
            self._has_flown = [False] * len(addresses)
            self._has_begun = np.zeros(len(addresses), bool)
            self._move_vehicles()
            self._reset_commands()
            self._begin_view()
            for robot in range(len(addresses)):
                self._hold(robot)
            fleet.restart_pace()
        except BaseException:
            fleet.close()
            raise

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Hold, disarm and disconnect."""
        self._stop_autopilots()

    def describe(self) -> list[VehicleReport]:
        """Return the state of each vehicle, for the person who arms it."""
        return self.autopilots.report()

    def describe_limits(self) -> str:
        """Return the limits that are held, as text."""
        limits, guard = self.settings.losses, self._guarded_sender.guards[0]
        return (
            f"held: speed of targets {guard.max_speed_mps:g} m/s, fence {guard.fence}; "
            f"{self.settings.at_end} at the end, after {limits.link_s:g} s without messages, and "
            f"after {limits.position_s:g} s without a position"
        )

    def arm(self, robots: Sequence[int] | None = None) -> None:
        """Arm robots in GUIDED; they stay where they are.

        Args:
            robots: their indices; all if left out.

        Raises:
            ConfigError: a robot is outside the fence.
            RunError: a vehicle refuses. Those that were armed are disarmed.
        """
        chosen = range(len(self.robots)) if robots is None else robots
        fleet = self.autopilots
        self._refresh()
        positions = fleet.estimate_motion().p
        for i in chosen:
            guard = self._guarded_sender.guards[i]
            if guard.fence.measure_distance(positions[i]) > ARM_MARGIN_M:
                x, y, z = map(float, positions[i])
                raise ConfigError(
                    f"{self.robots[i].name}: is at ({x:.2f}, {y:.2f}, {z:.2f}) m, more than "
                    f"{ARM_MARGIN_M:g} m outside the fence {guard.fence}; nothing is armed"
                )
        fleet.arm(chosen)
        self._move_vehicles()
        self._view.update(fleet, self._command_queue, self._command_sender)
        for i in chosen:
            self._hold(i)
            self._was_guided[i] = self._has_flown[i] = True
        fleet.restart_pace()

    def disarm(self, robots: Sequence[int] | None = None) -> None:
        """Request to stop the motors of robots, by their indices; of all if left out."""
        for i in range(len(self.robots)) if robots is None else robots:
            self.autopilots.pilots[i].disarm()

    def reset(self, seed: int | None = None) -> Observation:
        """Refuse: vehicles are not put back to their starts.

        Raises:
            RunError: always.
        """
        raise RunError("vehicles in the water cannot be reset; open another session")

    def summarise(self) -> JsonTable:
        """Return the entries of a run's summary."""
        names = [robot.name for robot in self.robots]
        guards, pilots = self._guarded_sender.guards, self._fleet.pilots
        overruns = self._fleet.overruns
        return {
            "endpoints": dict(zip(names, self._fleet.addresses, strict=True)),
            "system_ids": {pilot.name: pilot.sysid for pilot in pilots},
            "truth": "none; positions are the autopilots' estimates",
            "outcomes": dict(self.outcomes),
            "end": self.end_note,
            "max_speed_mps": self.settings.max_speed_mps,
            "fence_m": [list(guards[0].fence.lower_m), list(guards[0].fence.upper_m)],
            "changed_targets": {
                name: dict(guard.counts) for name, guard in zip(names, guards, strict=True)
            },
            "ignored_messages": {pilot.name: dict(pilot.link.counts) for pilot in pilots},
            "ignored_packets": {
                endpoint.address.text: dict(endpoint.counts) for endpoint in self._fleet.endpoints
            },
            "overruns": overruns.count,
        }

    def step(self, commands: Mapping[int, SessionCommand] | None = None) -> Observation:
        """Step as `Session.step`, to the end of the control period by the wall clock.

        Raises:
            ConfigError: a command for a missing robot.
            LossError: a link, a position or an autopilot is lost; flying vehicles were commanded
                the action of the end, and the session is over.
        """
        self._require_open()
        if self._autopilots is not None:
            if self._fleet.time_s - self._fleet.polled_s > STALL_S:
                try:
                    self._refresh()  # what has waited is old
                except RunError:
                    self._require_all()
                    raise
                self._fleet.restart_pace()
            self._release_taken_robots()
        return super().step(commands)

    def observe(self) -> Observation:
        """Observe as `Session.observe`; there is no truth."""
        return replace(super().observe(), truth=None)

    def finish(self) -> None:
        """End the flight: command the action of the end, and disconnect.

        Recordings still read the session until it is closed.
        """
        self._stop_autopilots()

    def _refresh(self) -> None:
        """Wait for new positions of all vehicles.

        Raises:
            RunError: one has none.
        """
        fleet, limits = self.autopilots, self.settings.losses
        fleet.take_waiting()  # a packet that waited shows no living vehicle
        since_s = fleet.time_s
        until_s = since_s + REFRESH_TIMEOUT_S
        while any(pilot.position_good_s < since_s for pilot in fleet.pilots):
            if fleet.wait() > until_s:
                losses = [find_loss(pilot, limits, fleet.time_s) for pilot in fleet.pilots]
                texts = [loss.text for loss in losses if loss is not None]
                raise RunError("; ".join(texts) or "no new positions arrive")

    def _advance_period(self) -> None:
        """Advance one control period: look for losses, decide, send, wait, judge."""
        scene, fleet = self._scene, self.autopilots
        before = scene.state
        self._guarded_sender.positions_m = np.asarray(self._view.estimated_view.p, float)
        decision = self._command_sender.steer(
            scene,
            fleet.pilots,
            self.robots,
            self._view.belief,
            self._command_queue.slots.commands(),
        )
        fleet.advance()
        self._require_all()
        self._move_vehicles()
        scene.judge(np.array(decision.approaching)[0])
        self._begin_episodes()
        self._steps += 1
        self._view.record_step(before, decision)

    def _begin_episodes(self) -> None:
        """Keep the episodes of robots at their beginning until they fly inside the fence."""
        guards = self._guarded_sender.guards
        for i, p in enumerate(np.asarray(self._scene.state.vehicles.p)[0]):
            is_inside = guards[i].fence.measure_distance(p) == 0.0
            self._has_begun[i] |= self._has_flown[i] and is_inside
        if not self._has_begun.all():
            self._scene.restart_episodes(~self._has_begun)

    def _release_taken_robots(self) -> None:
        """Let robots stay where they are that are not armed, or that somebody else drives."""
        for i, pilot in enumerate(self._fleet.pilots):
            if not pilot.is_guided or not self._was_guided[i]:
                self._hold(i)
            self._was_guided[i] = pilot.is_guided
            self._has_flown[i] |= pilot.is_guided

    def _require_all(self) -> None:
        """Raise if a vehicle, its position or its link is lost, after the action of the end."""
        fleet, limits = self._fleet, self.settings.losses
        found = {
            i: loss
            for i, pilot in enumerate(fleet.pilots)
            if (loss := find_loss(pilot, limits, fleet.time_s)) is not None
        }
        if not found:
            return
        note = self._end_flight({i: loss.kind for i, loss in found.items()})
        fleet.lost = {i: loss.text for i, loss in found.items()}
        texts = "; ".join(loss.text for loss in found.values())
        kind = next(iter(found.values())).kind
        raise LossError(kind, f"{kind}: {texts}; {note}" if note else f"{kind}: {texts}")

    def _end_flight(self, kinds: Mapping[int, LossKind] | None = None) -> str:
        """Command the action of the end until the heartbeats show it, and name the outcomes.

        Vehicles that are not armed, or that somebody else drives, are left alone.

        Args:
            kinds: losses, by the robot's index.

        Returns:
            What was commanded, and what was seen of it.
        """
        fleet, action, now = self._fleet, self.settings.at_end, self._fleet.time_s
        flying = [pilot for pilot in fleet.pilots if pilot.is_guided]
        max_blind_s = self.settings.losses.position_s
        blind = [pilot for pilot in flying if measure_blindness(pilot) > max_blind_s]
        left, until_s = flying, now + ACTION_S
        while left and fleet.time_s < until_s:
            for pilot in left:
                command_action(pilot, action, has_position=pilot not in blind)
            fleet.wait()
            left = [
                pilot
                for pilot in left
                if not is_followed(pilot, action, has_position=pilot not in blind)
            ]
        for i, pilot in enumerate(fleet.pilots):
            ended = "flown" if self._has_flown[i] else "not_flown"
            self.outcomes[pilot.name] = (kinds or {}).get(i, ended)
        if not flying:
            return ""
        seen = "; ".join(
            f"{pilot.name} {'does not confirm' if pilot in left else 'confirms'}: {pilot.note()}"
            for pilot in flying
        )
        self.end_note = f"commanded to {action}: {seen}"
        return self.end_note

    def _require_drivable(self, robot: int) -> None:
        """Raise unless a robot is guided; an ended episode of the scenario does not matter."""
        self._require_open()
        robot_checks.require_robot(self.robots, robot)
        pilot = self._fleet.pilots[robot]
        if not pilot.is_guided:
            raise ConfigError(f"{pilot.name}: takes no commands, it is {pilot.note()}")

    def _move_vehicles(self) -> None:
        motion = self._fleet.estimate_motion()
        self._scene.move_vehicles(motion.p, motion.q, motion.nu, self._fleet.pwm)

    def _stop_autopilots(self) -> None:
        """End the flight and disconnect, if that was not done."""
        if self._autopilots is None:
            return
        try:
            if not self.outcomes:
                self._end_flight()
        finally:
            super()._stop_autopilots()


def _find_fence(scene: AutopilotScene) -> Fence:
    """Return the region of a scene's world."""
    environment = jax.tree.map(lambda leaf: np.asarray(leaf)[0], scene.worlds.environment)
    lower, upper = (np.asarray(corner, float) for corner in region_corners(environment))
    return Fence(
        lower_m=(float(lower[0]), float(lower[1]), float(lower[2])),
        upper_m=(float(upper[0]), float(upper[1]), float(upper[2])),
    )
