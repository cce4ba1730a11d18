"""View of a session on its scene: the truth, the autopilots' estimates, and records of both."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Protocol

import jax
import numpy as np
from numpy.typing import NDArray

from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.stack import ControlMemory
from angler_mjx.runs.session.command_queue import CommandQueue
from angler_mjx.runs.session.fleet_facts import FleetFacts
from angler_mjx.runs.session.interface import Floats, Observation, RobotStatus
from angler_mjx.runs.session.state_view import (
    StateView,
    WatchedTrajectories,
    apply_belief,
    build_observation,
    view_state,
)
from angler_mjx.sim import robot, step
from angler_mjx.sim.record import Belief, Sample, WorldRecord, build_sample
from angler_mjx.sim.state import FleetWorld, WorldState
from angler_sitl.scene.flat_arrays import Arrays, FlatLayout
from angler_sitl.scene.motion import MAX_PULSE_US, MIN_PULSE_US
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering.autopilot_commander import EstimatedMotion
from angler_sitl.steering.command_sender import CommandSender
from angler_sitl.steering.guidance import GuidanceDecision, belief_from_motion, belief_from_truth


class SteeredAutopilots(Protocol):
    """Autopilots as a session needs them."""

    @property
    def pwm(self) -> NDArray[np.int32]:
        """Return the last pulse widths [R, 16], us."""
        ...

    @property
    def lost(self) -> Mapping[int, str]:
        """Return why robots, by their index, cannot go on."""
        ...

    def estimate_motion(self) -> EstimatedMotion:
        """Return the estimates of their motion at the current time."""
        ...

    def note(self, robot: int) -> str:
        """Return a short note on the state of a robot's autopilot."""
        ...

    def close(self) -> None:
        """Close all; a second call has no effect."""
        ...


class SessionView:
    """Last view of a scene.

    Attributes:
        view: the truth.
        seen: the autopilots' estimate of it, or the truth where that is used.
        belief: of the robots, for the controllers; [1, R] leads.
        target_m: [R, 3] target position of the last step, in W.
        sample: of the state before the last step, with its command; None before the first.
    """

    def __init__(
        self, scene: AutopilotScene, facts: FleetFacts, tolerances: Tolerances, *, use_truth: bool
    ) -> None:
        """Create the view; nothing is observed yet.

        Args:
            scene: scene to observe.
            facts: of its robots.
            tolerances: tolerances of JointTrajectories, [R] leading.
            use_truth: whether robots receive the truth instead of their autopilots' estimates.
        """
        self._scene, self._facts, self._tolerances, self._uses_truth = (
            scene,
            facts,
            tolerances,
            use_truth,
        )
        self._layout: FlatLayout[StateView] | None = None
        self.sample: Sample | None = None
        self.view: StateView
        self.estimated_view: StateView
        self.belief: Belief
        self.target_m: Floats

    def begin(
        self,
        autopilots: SteeredAutopilots,
        command_queue: CommandQueue,
        command_sender: CommandSender,
    ) -> None:
        """Observe for the first time: every robot's target is its own position."""
        self.update(autopilots, command_queue, command_sender)
        self.target_m = np.asarray(self.estimated_view.p)

    def update(
        self,
        autopilots: SteeredAutopilots,
        command_queue: CommandQueue,
        command_sender: CommandSender,
    ) -> None:
        """Update the view from the current state."""
        scene, watched = self._scene, None
        if JointTrajectory in command_queue.slots.kinds:
            watched = WatchedTrajectories(
                trajectory=command_queue.slots.slot(JointTrajectory),
                allowed=self._tolerances,
                before=as_leaf(command_queue.results),
            )
        signals = self._thruster_pwm(autopilots.pwm)
        view_inputs = (scene.worlds, scene.judged, command_sender.memory, signals, watched)
        if self._layout is None:
            self._layout = FlatLayout.from_tree(
                jax.eval_shape(partial(_view_scene, scene.state_layout), *view_inputs)
            )
        arrays = _view_scene_flat(scene.state_layout, *view_inputs)
        view = self._layout.unpack(tuple(map(np.asarray, arrays)))
        vehicles = scene.state.vehicles
        self.belief = (
            belief_from_truth(vehicles)
            if self._uses_truth
            else belief_from_motion(autopilots.estimate_motion(), vehicles.p)
        )
        self.view, self.estimated_view = view, apply_belief(view, self.belief)

    def record_step(self, before: WorldState, decision: GuidanceDecision) -> None:
        """Record a step, with the pulses that its energy was counted by.

        Args:
            before: state at the start of the step.
            decision: decision of the step.
        """
        self.target_m = np.asarray(decision.target_m)[0]
        record = {
            **step.record_decided(
                as_leaf(self._thruster_pwm(self._scene.pulses)), decision.target_m
            ),
            **step.record_motion(before.vehicles, before.tally.outcome, decision.current_mps),
            **self._scene.record,
        }
        links = self._scene.worlds.control.vehicle.links
        if links is not None and before.vehicles.joints is not None:
            record["joints"] = _record_joints(links, before.vehicles.joints)
        belief = None if self._uses_truth else self.belief
        self.sample = build_sample(WorldRecord(belief=belief), record)

    def make_observation(self, time_s: float, status: tuple[RobotStatus, ...]) -> Observation:
        """Return the observation of the session.

        Args:
            time_s: of the session.
            status: of each robot.
        """
        return build_observation(
            self._facts,
            self.view,
            self.estimated_view,
            time_s=time_s,
            covariance=None,
            target_m=self.target_m,
            status=status,
        )

    def _thruster_pwm(self, pulses: NDArray[np.int32]) -> np.ndarray:
        """Return [1, R, n_thruster] pulse widths of [R, 16], neutral where there is no pulse."""
        pwm = pulses[None, :, : self._facts.thrusters]
        is_pulse = (pwm >= MIN_PULSE_US) & (pwm <= MAX_PULSE_US)
        return np.where(is_pulse, pwm, NEUTRAL_US).astype(self._scene.state.vehicles.p.dtype)


_record_joints = jax.jit(jax.vmap(jax.vmap(robot.record_joints)))
"""`robot.record_joints` of links and joints, [1, R] leading."""


def _view_scene(
    layout: FlatLayout[WorldState],
    worlds: FleetWorld,
    judged: Arrays,
    memory: ControlMemory,
    pwm_us: jax.Array,
    watched: WatchedTrajectories | None,
) -> StateView:
    state: WorldState = replace(layout.unpack(judged), carry=memory)
    view: StateView = view_state(worlds, state, pwm_us, watched)
    return view


@partial(jax.jit, static_argnums=0)
def _view_scene_flat(
    layout: FlatLayout[WorldState],
    worlds: FleetWorld,
    judged: Arrays,
    memory: ControlMemory,
    pwm_us: jax.Array,
    watched: WatchedTrajectories | None,
) -> Arrays:
    view = _view_scene(layout, worlds, judged, memory, pwm_us, watched)
    return FlatLayout.from_tree(view).pack(view)
