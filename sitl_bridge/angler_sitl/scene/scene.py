"""Water and vehicles of the simulator under real autopilots: one world of a scenario.

Vehicle files, sampled parameter sets, rotors, current, cells and obstacles are those of world
number `world` of a run of the scenario. The pulse widths of the autopilots move the vehicles, 400
times a second; the outcome is judged once a control period.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np
from numpy.typing import NDArray

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands.whole_body import JointTarget, hold_joints
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.carry_table import CarryTask
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.task_table import require_goal_task
from angler_mjx.sim.fleet import count_joints
from angler_mjx.sim.phase import Record
from angler_mjx.sim.state import FleetWorld, Outcome, World, WorldState
from angler_mjx.world.acoustics.config import refuse_acoustics
from angler_sitl.scene import motion, outcome_judge
from angler_sitl.scene.contact_motion import compile_contact_motion
from angler_sitl.scene.flat_arrays import FlatLayout
from angler_sitl.wire.packets import STATE_NUMBERS

type Floats = NDArray[np.float64]

DT_S = 1 / 400
"""Period of ArduSub's own main loop."""


@dataclass(frozen=True, kw_only=True)
class SensorStates:
    """Sensor states of all vehicles at one time; [N] leads."""

    numbers: Floats
    """[N, 16] in the order of `packets.STATE_NUMBERS`."""

    @property
    def gyro(self) -> Floats:
        """[N, 3] rad/s in FRD."""
        return self.numbers[:, 0:3]

    @property
    def accel_body(self) -> Floats:
        """[N, 3] specific force, m/s^2 in FRD: minus gravity at rest."""
        return self.numbers[:, 3:6]

    @property
    def p_ned(self) -> Floats:
        """[N, 3] m in NED from home, which is W's origin."""
        return self.numbers[:, 6:9]

    @property
    def q(self) -> Floats:
        """[N, 4] FRD to NED."""
        return self.numbers[:, 9:13]

    @property
    def v_ned(self) -> Floats:
        """[N, 3] m/s in NED."""
        return self.numbers[:, 13:16]


class AutopilotScene:
    """Vehicles in the water of one world.

    Attributes:
        simulator: of the scenario, one world a tile.
        worlds: the world; [1] leads.
        state: state at the last judgement; [1] leads. Controller memory in it is not updated.
        judged: the same as few arrays on the device.
        record: record of the last judgement, by field; [1] leads. Empty before the first.
        states: current sensor states of the vehicles.
        dt_s: length of a step.
        period: steps in a control period.
        moored: whether the vehicles are held at their starts, at rest, with the world's time at 0
            while the autopilots boot; so after `reset`.
    """

    def __init__(self, scenario: Scenario, *, world: int = 0, dt_s: float = DT_S) -> None:
        """Sample the world and compile everything that a step needs.

        Args:
            scenario: scenario to simulate.
            world: index of the world in the scenario.
            dt_s: length of a step.

        Raises:
            ConfigError: no whole number of steps makes a control period.
        """
        require_goal_task(
            scenario.task,
            "autopilots are told of no task; fly it with angler rollout, or take a scenario of "
            'type = "goal" or "carry"',
            also=(CarryTask,),
        )
        if isinstance(scenario.task, CarryTask) and scenario.task.approach is not None:
            raise ConfigError(
                "task.approach: grippers that close in flight are not flown beside autopilots; "
                "leave it out, or fly it with angler rollout"
            )
        refuse_acoustics(
            scenario.acoustics,
            'autopilots hear nothing of each other; take "perfect", or fly it with angler rollout',
        )
        # The closed form is MJX's, to rounding, for one rigid body; links are the same code.
        is_rigid = not (scenario.contacts or count_joints(scenario.members()))
        engine = "fused" if is_rigid else "mjx"
        single_world = scenario.model_copy(update={"tile": 1, "engine": engine, "kernels": "xla"})
        self.simulator, self.dt_s, self._index = Simulator(single_world), dt_s, world
        self._spec, self._seed = self.simulator.spec, single_world.seed
        self.steps_per_period = round(self._spec.control_dt_s / dt_s)
        if abs(self.steps_per_period * dt_s - self._spec.control_dt_s) > 1e-9:
            raise ConfigError(
                f"time.control_dt_s = {self._spec.control_dt_s:g}: with real autopilots it must be "
                f"a whole number of steps of {1e3 * dt_s:g} ms"
            )
        self._sampled_seed: int | None = None
        self._sample_world(self._seed)
        self._motion = self._compile_motion()
        self._judge = outcome_judge.compile_judge(
            self._spec, self._motion, self.worlds, self._start
        )
        self.reset()

    def reset(self, seed: int | None = None, worlds: World | None = None) -> None:
        """Reset the scene: all vehicles at their starts, moored, all clocks at 0.

        Args:
            seed: of the world; the scenario's if left out. Nothing is compiled for another one.
            worlds: replaces the sampled world; [1] leads, of the same shapes.
        """
        if worlds is None:
            self._sample_world(self._seed if seed is None else seed)
        else:
            self.worlds: FleetWorld = self.simulator.add_parameters(worlds)
            self._start, self._sampled_seed = self.simulator.reset(worlds), None
        self._motion_constants = self._motion.pack_constants(self.worlds)
        self._judge_constants = self._judge.pack_constants(self.worlds)
        self.judged = self._judge.to_arrays(self._start)
        self._moving = self._motion.to_arrays(self._start)
        self._inputs = np.zeros((self._moving[0].shape[0], motion.N_INPUTS), np.int32)
        self._ticks, self._steps = 0, 0
        self.state, self.moored = self._start, True
        joints = self._start.vehicles.joints
        self._targets: tuple[jax.Array, np.int32] | tuple[()] = ()
        self.command_joints(None if joints is None else hold_joints(joints))
        self.record: Record = {}
        # Failed robots are held in place: so the state at rest of every robot is known.
        self._inputs[:, motion.OUTCOME_COLUMN] = Outcome.OUT_OF_BOUNDS
        at_rest = np.asarray(self._step_motion()[0])
        # Wait for the result: the step may read our array itself while we go on.
        self._inputs[:, motion.OUTCOME_COLUMN] = Outcome.RUNNING
        self.states = SensorStates(numbers=at_rest[:, :STATE_NUMBERS])

    @property
    def state_layout(self) -> FlatLayout[WorldState]:
        """Layout of `judged`."""
        return self._judge.state

    @property
    def time_s(self) -> float:
        """Time of the autopilots' clock, s; it runs while the vehicles are moored too."""
        return self._ticks * self.dt_s

    @property
    def pulses(self) -> NDArray[np.int32]:
        """[N, 16] us, of the last step; the account of a period uses them."""
        return self._inputs[:, : motion.N_PULSES].copy()

    def step(self, pwm: NDArray[np.int32]) -> SensorStates:
        """Advance all vehicles by one step.

        Args:
            pwm: [N, 16] pulse widths, us; outside 900 to 2100 a thruster is off.
        """
        self._ticks += 1
        if self.moored:
            return self.states
        self._inputs[:, : motion.N_PULSES] = pwm
        self._inputs[:, motion.STEPS_COLUMN] = self._steps
        self._moving = self._step_motion()
        self._steps += 1
        self.states = SensorStates(numbers=np.asarray(self._moving[0])[:, :STATE_NUMBERS])
        return self.states

    def move_vehicles(
        self,
        p: NDArray[np.floating],
        q: NDArray[np.floating],
        nu: NDArray[np.floating],
        pulses: NDArray[np.int32],
    ) -> None:
        """Put all vehicles where they were estimated, one control period after the last time.

        For vehicles that move in other water than the simulator's; see `step` for those that do.

        Args:
            p: [N, 3] m, in W.
            q: [N, 4] F to W.
            nu: [N, 6] in F.
            pulses: [N, 16] us, of their thrusters.
        """
        self._ticks += self.steps_per_period
        dtype = self.state.vehicles.p.dtype
        p, q, nu = (values[None].astype(dtype) for values in (p, q, nu))
        moved = replace(self.state.vehicles, p=as_leaf(p), q=as_leaf(q), nu=as_leaf(nu))
        self._moving = self._motion.to_arrays(replace(self.state, vehicles=moved))
        self._inputs[:, : motion.N_PULSES] = pulses

    def restart_episodes(self, robots: NDArray[np.bool_]) -> None:
        """Judge robots [N] anew from now on, as at their starts."""

        def restart(now: np.ndarray, start: np.ndarray) -> np.ndarray:
            mask = robots.reshape(1, -1, *[1] * (np.ndim(now) - 2))
            restarted: np.ndarray = np.where(mask, start, now)
            return restarted

        tally = jax.tree.map(restart, self.state.tally, self._start.tally)
        self.state = replace(self.state, tally=tally)
        self.judged = self._judge.to_arrays(self.state)
        self._inputs[:, motion.OUTCOME_COLUMN] = self.state.tally.outcome[0]

    def command_joints(self, target: JointTarget | None) -> None:
        """Set what the servos of joints follow from now on; autopilots know nothing of joints.

        Args:
            target: [1, N, J] at the present time; None of a fleet without joints. It moves on with
                its speeds and accelerations until the next one.
        """
        if target is not None:
            self._targets = (self._motion.pack_targets(target), np.int32(self._steps))

    def judge(self, approaching: NDArray[np.bool_] | None = None) -> None:
        """Close a control period: move obstacles, detect contact, update accounts.

        Args:
            approaching: [N] robots on the last approach of their plans; if left out, the goals
                alone count.

        A failed robot stands still from then on, as an obstacle to the others. Call this after
        every `period` steps, except those in which the vehicles were moored.
        """
        rows = self._motion.extract_rows(self._moving)
        if approaching is None:
            approaching = np.ones(len(rows), bool)
        self.judged, record = self._judge.step(
            self._judge_constants,
            self.judged,
            rows,
            self._motion.extract_bodies(self._moving),
            self._inputs,
            approaching,
        )
        self.record = self._judge.record.unpack(tuple(map(np.asarray, record)))
        self.state = self._judge.from_arrays(self.judged)
        self._moving = self._motion.replace_grips(self._moving, self.state.grips)
        self._inputs[:, motion.OUTCOME_COLUMN] = self.state.tally.outcome[0]

    def _compile_motion(self) -> motion.SceneMotion:
        spec, worlds, start = self._spec, self.worlds, self._start
        if spec.contact is None:
            return motion.compile_motion(spec.water, self.dt_s, worlds, start.vehicles)
        return compile_contact_motion(
            spec.contact, spec.water, self.dt_s, self.steps_per_period, worlds, start
        )

    def _step_motion(self) -> motion.MotionArrays:
        """Return what moves after one step with the present inputs."""
        return self._motion.step(self._motion_constants, self._moving, self._inputs, *self._targets)

    def _sample_world(self, seed: int) -> None:
        if seed != self._sampled_seed:
            sampled = self.simulator.worlds(self._index, seed=seed)
            self.worlds = self.simulator.add_parameters(sampled)
            self._start = self.simulator.reset(sampled)
            self._sampled_seed = seed
