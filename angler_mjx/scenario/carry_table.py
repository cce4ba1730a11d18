"""The table of a scenario file on robots that carry one body, and what follows from it."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal, Self

import jax
import numpy as np
from pydantic import Field, model_validator

from angler_mjx.files import FileModel, JsonTable, dump_for_digest
from angler_mjx.quantities import MAX_COORDINATE_M
from angler_mjx.robot.control.laws.cargo_part import CargoPartGains
from angler_mjx.robot.control.stack import StackGains, Stages
from angler_mjx.robot.vehicles.load import Load
from angler_mjx.scenario.load_table import split_load
from angler_mjx.sim.cargo import ApproachSpec, CargoSpec, GripNoise
from angler_mjx.sim.physics.contact.grips import GripSpec, friction_limits
from angler_mjx.sim.physics.step import Water
from angler_mjx.world.config import Vector, WorldConfig, resolve_world
from angler_mjx.world.obstacles.config import ExplicitConfig
from angler_mjx.world.obstacles.explicit import explicit_rows, find_gaps_m, longest_axis

MAX_CARRIERS = 16
"""Max number of robots that carry one body."""


class GripSensorConfig(FileModel):
    """Errors of the force-torque sensors of grips: standard deviations along each axis."""

    force_std_n: float = Field(default=0.0, ge=0.0, le=1e5)
    """Of each reading, once a control period."""
    torque_std_nm: float = Field(default=0.0, ge=0.0, le=1e5)
    """Of each reading of a moment."""
    force_bias_n: float = Field(default=0.0, ge=0.0, le=1e5)
    """Of what a sensor is off by in a whole flight, sampled for each robot of each world."""
    torque_bias_nm: float = Field(default=0.0, ge=0.0, le=1e5)
    """The same of moments."""


class ApproachConfig(FileModel):
    """Way of robots to a body that they do not hold from the start."""

    above_m: float = Field(default=1.0, gt=0.0, le=MAX_COORDINATE_M)
    """Height of the robots at the start above where they hold the body."""
    within_m: float = Field(default=0.03, gt=0.0, le=MAX_COORDINATE_M)
    """Distance of a gripper from where it is to hold the body, in the body's frame, within which it
    closes; the body is then held as it is. The default is our choice, as the following."""
    within_deg: float = Field(default=10.0, gt=0.0, le=180.0)
    """Angle from the attitude in which it is to hold the body, within which it closes."""
    within_mps: float = Field(default=0.02, gt=0.0, le=10.0)
    """Speed of a gripper and the body against each other, below which it closes: what stops there
    at once pulls at the grip."""
    wait_s: float = Field(default=5.0, ge=0.0, le=3600.0)
    """Time for which plans leave the robots at the body."""
    lift_m: float = Field(default=0.0, ge=0.0, le=MAX_COORDINATE_M)
    """Height by which plans lift the body straight up first, such as off the sea floor."""


class CarryTask(FileModel):
    """One body, which the whole fleet carries to a pose; with ``contacts = true``.

    Each robot holds the body from the start, at the pose that it starts at, or goes there first.
    """

    type: Literal["carry"]
    body: int = Field(default=0, ge=0, le=4095)
    """Index in world.obstacles.explicit of the body, which drifts."""
    grips_m: tuple[Vector, ...] = Field(default=(), max_length=MAX_CARRIERS)
    """Start of each robot's centre of mass from the centre of the body; east, north, up. If left
    out, robots stand side by side along the longest axis of the body, as far apart as it lets
    them, at offset_m from it."""
    offset_m: Vector = (0.0, 0.0, 0.6)
    """Start of the robots' centres of mass from that axis; not with grips_m. Where end effectors
    hold the body it is that of theirs, and 0 if left out."""
    hold: Literal["hull", "end_effector"] = "hull"
    """Part of the robots that holds the body: the hull, or the end effector of the arm."""
    to_m: Vector
    """Centre of the body at the goal, in W."""
    turn_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """Turn of the body about z up, from the start to the goal."""
    tolerance_m: float = Field(default=0.1, gt=0.0, le=MAX_COORDINATE_M)
    """Distance of the body from its goal below which it has arrived."""
    tolerance_deg: float = Field(default=5.0, gt=0.0, le=180.0)
    """Angle from its attitude at the goal below which it has arrived."""
    break_force_n: float | None = Field(default=None, gt=0.0, le=1e6)
    """Force of a grip above which it breaks, and the robot's episode ends as `dropped`; it holds
    any force if left out."""
    closing_force_n: float | None = Field(default=None, gt=0.0, le=1e5)
    """Force with which the jaws of end effectors close, along y of the end effector: the body slips
    in them where it pulls harder than friction (of the materials of robot and obstacle) holds. The
    grip is a weld if left out."""
    jaw_m: float = Field(default=0.015, gt=0.0, le=1.0)
    """Radius of the patch of a jaw on the body; with closing_force_n. The default is our choice."""
    max_slip_m: float = Field(default=0.05, gt=0.0, le=MAX_COORDINATE_M)
    """Slip beyond which jaws have lost the body, and the robot's episode ends as `dropped`."""
    hold_s: float = Field(default=0.0, ge=0.0, le=3600.0)
    """Time without a break for which the body has to be at its goal to have arrived."""
    release: bool = False
    """Whether grips open when the body has arrived; it then sinks, rises or rests."""
    sensor: GripSensorConfig | None = None
    """Errors of what grips measure; none if left out."""
    approach: ApproachConfig | None = None
    """Grippers begin open, above the body, and close when they are there; robots hold the body from
    the start if left out."""

    by_end_effector: ClassVar[bool] = False
    """As of `GoalTask`."""

    @model_validator(mode="before")
    @classmethod
    def _set_offset(cls, table: object) -> object:
        """Set the offset of end effectors from the axis to 0, where the file gives none."""
        if not isinstance(table, dict) or table.get("hold") != "end_effector":
            return table
        if table.get("grips_m") or "offset_m" in table:
            return table
        return {**table, "offset_m": (0.0, 0.0, 0.0)}

    @property
    def cargo(self) -> CargoSpec:
        """Return the settings of the simulator."""
        return CargoSpec(
            body=self.body,
            goal_m=self.to_m,
            turn_rad=math.radians(self.turn_deg),
            tolerance_m=self.tolerance_m,
            tolerance_rad=math.radians(self.tolerance_deg),
            hold_s=self.hold_s,
            release=self.release,
            approach=self._approach_spec(),
        )

    def _approach_spec(self) -> ApproachSpec | None:
        approach = self.approach
        if approach is None:
            return None
        return ApproachSpec(
            above_m=approach.above_m,
            within_m=approach.within_m,
            within_rad=math.radians(approach.within_deg),
            within_mps=approach.within_mps,
            wait_s=approach.wait_s,
            lift_m=approach.lift_m,
        )

    def problem_table(self) -> JsonTable:
        """Return the table for digests, which stay those from before release existed."""
        table = dump_for_digest(self)
        jaws = self.closing_force_n is not None
        added = {"hold_s": self.hold_s, "release": self.release, "hold": self.hold != "hull"}
        added["approach"] = self.approach is not None
        added |= dict.fromkeys(("closing_force_n", "jaw_m", "max_slip_m"), jaws)
        added["sensor"] = False  # of the flight, not of the problem, as all instruments
        return {key: value for key, value in table.items() if added.get(key, True)}

    @property
    def grip_noise(self) -> GripNoise | None:
        """Return the errors of the force-torque sensors of grips; None where there are none."""
        return None if self.sensor is None else GripNoise(**self.sensor.model_dump())

    @model_validator(mode="after")
    def _check_jaws(self) -> Self:
        if self.closing_force_n is None:
            fields = type(self).model_fields
            for key in ("jaw_m", "max_slip_m"):
                if getattr(self, key) != fields[key].default:
                    raise ValueError(f"task.{key}: of jaws; give task.closing_force_n too")
        elif self.hold != "end_effector":
            raise ValueError(
                "task.closing_force_n: jaws are those of end effectors; give task.hold = "
                '"end_effector"'
            )
        elif self.break_force_n is not None:
            raise ValueError(
                "task.break_force_n, task.closing_force_n: a weld breaks and jaws slip; give one"
            )
        return self

    def grip(self, friction: float) -> GripSpec:
        """Return the grips of the simulator.

        Args:
            friction: Coulomb's coefficient of robots on obstacles.
        """
        limits = None
        if self.closing_force_n is not None:
            limits = friction_limits(self.closing_force_n, friction, self.jaw_m)
        return GripSpec(
            body=self.body,
            break_force_n=self.break_force_n,
            by_end_effector=self.hold == "end_effector",
            friction_limits=limits,
            max_slip_m=self.max_slip_m,
        )

    def _grip_offsets(self, body: ExplicitConfig, robots: int) -> np.ndarray:
        """Return the starts [R, 3] of robots from the centre of the body, m, in W."""
        if not self.grips_m:
            if robots > MAX_CARRIERS:
                raise ValueError(
                    f'task.type = "carry": the fleet has {robots} robots; {MAX_CARRIERS} are the '
                    "most that hold one body"
                )
            half_axis_m = longest_axis(body)
            along = np.linspace(-1.0, 1.0, robots) if robots > 1 else np.zeros(1)
            return along[:, None] * half_axis_m + self.offset_m
        if "offset_m" in self.model_fields_set:
            raise ValueError("task.offset_m and task.grips_m: give one of them, not both")
        if len(self.grips_m) != robots:
            raise ValueError(
                f"task.grips_m has {len(self.grips_m)} positions and the fleet {robots} robots: "
                "give one for each"
            )
        return np.array(self.grips_m)

    def position_robots(self, world: WorldConfig, tips_m: np.ndarray) -> WorldConfig:
        """Return the world with the starts and goals of the robots that hold the body.

        Args:
            world: of the scenario.
            tips_m: [R, 3] point of each robot that holds the body, from its centre of mass, m, in
                F, at the start; 0 where hulls hold it.

        Raises:
            ValueError: there is no such body, or the world or the fleet does not fit it.
        """
        explicit = resolve_world(world).obstacles.explicit
        if self.body >= len(explicit):
            raise ValueError(
                f"task.body = {self.body}: world.obstacles.explicit has {len(explicit)} bodies"
            )
        body = explicit[self.body]
        if body.motion.type != "drift":
            raise ValueError(
                f"task.body = {self.body}: its motion is {body.motion.type!r}, so nobody can carry "
                'it; give motion.type = "drift"'
            )
        grips = self._grip_offsets(body, len(tips_m))
        if self.hold == "end_effector":
            _check_reach(body, grips)
        turn = _turn_about_z(math.radians(self.turn_deg))
        travel_m = np.subtract(self.to_m, body.position_m)
        offsets = grips - _aim_tips(grips, tips_m, turn, travel_m)
        above_m = 0.0 if self.approach is None else self.approach.above_m
        starts = (np.array(body.position_m) + offsets + [0.0, 0.0, above_m]).round(9)
        goals = (np.array(self.to_m) + offsets @ turn.T).round(9)
        made = {
            "placement": "given",
            "start_m": tuple(tuple(row) for row in starts.tolist()),
            "goal_m": tuple(tuple(row) for row in goals.tolist()),
        }
        for key, value in made.items():
            if getattr(world, key) not in (None, (), value):
                raise ValueError(
                    f'world.{key}: task.type = "carry" says where robots start and go; leave it out'
                )
        positioned = world.model_copy(update=made)
        # They count as left out: a file edited for another team computes them again.
        positioned.model_fields_set.difference_update(made.keys() - world.model_fields_set)
        return positioned


MAX_GRIP_GAP_M = 0.02
"""Greatest distance of an end effector from the surface of the body that it holds, m: our choice,
somewhat more than the opening of the shipped gripper, 15 mm."""


def _turn_about_z(angle_rad: float) -> np.ndarray:
    """Return the matrix [3, 3] of a turn about z up."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _aim_tips(
    grips: np.ndarray, tips_m: np.ndarray, turn: np.ndarray, travel_m: np.ndarray
) -> np.ndarray:
    """Return the tips [R, 3] in W at the start, where each robot heads for its goal.

    The heading depends on start and goal, and these on the heading: it is found by iteration.

    Args:
        grips: [R, 3] points of the grips from the centre of the body, m, in W.
        tips_m: [R, 3] the same from the centres of mass of the robots, in F.
        turn: [3, 3] turn of the body from start to goal.
        travel_m: [3] from the centre of the body at the start to that at the goal.

    Raises:
        ValueError: a robot has no heading that keeps to that.
    """
    tips = tips_m.copy()
    if not tips_m.any():
        return tips
    for _ in range(100):
        to_goal = travel_m + (grips - tips) @ (turn - np.eye(3)).T
        headings = np.arctan2(to_goal[:, 1], to_goal[:, 0])
        before, tips = (
            tips,
            np.stack([_turn_about_z(yaw) @ tip for yaw, tip in zip(headings, tips_m, strict=True)]),
        )
        if np.abs(tips - before).max() < 1e-12:
            return tips
    raise ValueError(
        "task.to_m, task.turn_deg: no heading of the robots at the start leads them to their goals "
        "with their end effectors at the body; take a longer way or a smaller turn"
    )


def _check_reach(body: ExplicitConfig, grips: np.ndarray) -> None:
    """Refuse grips [R, 3], m from the centre of a body, that are not at its surface or in it.

    Raises:
        ValueError: naming them, with their distances.
    """
    faults = [
        f"grip {i} is {gap:.3g} m from the surface of the body"
        for i, gap in enumerate(find_gaps_m(body, grips))
        if gap > MAX_GRIP_GAP_M
    ]
    if faults:
        raise ValueError(
            f"task.grips_m or task.offset_m: {'; '.join(faults)}, and end effectors hold at most "
            f"{MAX_GRIP_GAP_M:g} m from it; give points of the body"
        )


def find_cargo_load(task: CarryTask, world: WorldConfig, density_kgpm3: float) -> Load:
    """Return what each robot bears of the body.

    Added mass and drag are those along the axes of the robots, on average.

    Args:
        task: of the fleet.
        world: with the starts and goals of the robots.
        density_kgpm3: of the water.
    """
    resolved = resolve_world(world)
    with jax.ensure_compile_time_eval():  # also where it is asked for within a program
        return split_load(
            explicit_rows(resolved.obstacles.explicit, density_kgpm3),
            task.body,
            np.subtract(resolved.goal_m, resolved.start_m),
            density_kgpm3,
        )


def fill_cargo_gains(
    task: CarryTask,
    world: WorldConfig,
    load: Load,
    stages: Stages,
    gains: StackGains,
    stated: Mapping[str, Mapping[str, float]],
) -> StackGains:
    """Return gains in which stages of carriers know the part of each robot in its load.

    Args:
        task: of the fleet.
        world: with the starts and goals of the robots.
        load: part of each robot.
        stages: of the controllers.
        gains: of each stage.
        stated: gains that the file gives, by the name of their stage.
    """
    drag = (0.5 * load.density_kgpm3 * area for area in load.drag_area_m2)
    resolved = resolve_world(world)
    below_m = np.mean([start[2] for start in resolved.start_m])
    below_m -= resolved.obstacles.explicit[task.body].position_m[2]
    below_m -= 0.0 if task.approach is None else task.approach.above_m
    values = {
        "depth_m": max(0.0, float(below_m)),
        "weight_n": max(0.0, load.mass_kg - load.density_kgpm3 * load.volume_m3)
        * Water().gravity_mps2,
        **dict(zip(("drag_x_n", "drag_y_n", "drag_z_n"), drag, strict=True)),
    }
    return tuple(
        replace(numbers, **(values | dict(stated.get(stage.name, {}))))
        if isinstance(numbers, CargoPartGains)
        else numbers
        for stage, numbers in zip(stages, gains, strict=True)
    )
