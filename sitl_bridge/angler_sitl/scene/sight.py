"""What a session shows of its scene: the truth, what autopilots believe, and records of both."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.joint_tolerance import Tolerances
from angler_mjx.robot.control.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.stack import ControlMemory
from angler_mjx.runs.session.command_queue import CommandQueue
from angler_mjx.runs.session.fleet_facts import Facts
from angler_mjx.runs.session.interface import Floats, Observation, RobotStatus
from angler_mjx.runs.session.view import StateView, Watched, believed, look, shown
from angler_mjx.sim import step
from angler_mjx.sim.record import Belief, Sample
from angler_mjx.sim.state import World, WorldState
from angler_sitl.autopilots import Autopilots
from angler_sitl.scene.flat import Arrays, Flat
from angler_sitl.scene.motion import HIGH_US, LOW_US
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.steering.command_sender import CommandSender
from angler_sitl.steering.guidance import Decision, belief_of, trusting


class SessionView:
    """A scene as it was seen last.

    Attributes:
        view: the truth.
        seen: the same as the robots' autopilots know it, or the truth where that is trusted.
        belief: of the robots, for the controllers; [1, R] leads.
        target_m: [R, 3] place aimed at in the last step, in W.
        sample: of the state before the last step, with its command; None before the first.
    """

    def __init__(
        self, scene: AutopilotScene, facts: Facts, allowed: Tolerances, *, truth: bool
    ) -> None:
        """Nothing is seen yet.

        Args:
            scene: to look at.
            facts: of its robots.
            allowed: tolerances of JointTrajectories, [R] leading.
            truth: whether robots are told the truth, and not what their autopilots believe.
        """
        self._scene, self._facts, self._allowed, self._truth = scene, facts, allowed, truth
        self._layout: Flat | None = None
        self.sample: Sample | None = None
        self.view: StateView
        self.seen: StateView
        self.belief: Belief
        self.target_m: Floats

    def begin(self, autopilots: Autopilots, orders: CommandQueue, helm: CommandSender) -> None:
        """Look for the first time: everybody aims at where it is."""
        self.look(autopilots, orders, helm)
        self.target_m = np.asarray(self.seen.p)

    def look(self, autopilots: Autopilots, orders: CommandQueue, helm: CommandSender) -> None:
        """Look at what is there now."""
        scene, watched = self._scene, None
        if JointTrajectory in orders.slots.kinds:
            before: Any = orders.results
            watched = Watched(
                trajectory=orders.slots.slot(JointTrajectory), allowed=self._allowed, before=before
            )
        signals = self._signals(autopilots.lockstep.pwm)
        given = (scene.worlds, scene.judged, helm.memory, signals, watched)
        if self._layout is None:
            self._layout = Flat.of(jax.eval_shape(partial(_look, scene.layout), *given))
        arrays = _look_flat(scene.layout, *given)
        view: StateView = self._layout.unpack(tuple(map(np.asarray, arrays)))
        vehicles = scene.state.vehicles
        self.belief = (
            trusting(vehicles) if self._truth else belief_of(autopilots.motion(), vehicles.p)
        )
        self.view, self.seen = view, believed(view, self.belief)

    def keep(self, before: WorldState, decision: Decision) -> None:
        """Keep a record of a step, with the pulses that its energy was counted by.

        Args:
            before: the state that it began with.
            decision: what was decided then.
        """
        self.target_m = np.asarray(decision.target_m)[0]
        record = {
            **step.record_decided(self._signals(self._scene.pulses), decision.target_m),
            **step.record_motion(before.vehicles, before.tally.outcome, decision.current_mps),
            **self._scene.record,
        }
        self.sample = Sample(**record, belief=None if self._truth else self.belief)

    def observation(self, time_s: float, status: tuple[RobotStatus, ...]) -> Observation:
        """As sessions show it.

        Args:
            time_s: of the session.
            status: of each robot.
        """
        return shown(
            self._facts,
            self.view,
            self.seen,
            time_s=time_s,
            covariance=None,
            target_m=self.target_m,
            status=status,
        )

    def _signals(self, pulses: NDArray[np.int32]) -> Any:
        """[1, R, n_thruster] pulse widths of [R, 16], neutral where there is no pulse."""
        pwm = pulses[None, :, : self._facts.thrusters]
        pulse = (pwm >= LOW_US) & (pwm <= HIGH_US)
        return np.where(pulse, pwm, NEUTRAL_US).astype(self._scene.state.vehicles.p.dtype)


def _look(
    layout: Flat,
    worlds: World,
    judged: Arrays,
    memory: ControlMemory,
    pwm_us: jax.Array,
    watched: Watched | None,
) -> StateView:
    state: WorldState = replace(layout.unpack(judged), carry=memory)
    view: StateView = look(worlds, state, pwm_us, watched)
    return view


@partial(jax.jit, static_argnums=0)
def _look_flat(layout: Flat, *given: Any) -> Arrays:
    view = _look(layout, *given)
    return Flat.of(view).pack(view)
