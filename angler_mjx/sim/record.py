"""What is recorded of a world: every field declared once, and everything else is derived from here.

A field of `Sample` says which phase of a control step gives it (`angler_mjx.sim.step`), along which
axes it lies, in which unit and frame, and how it is stored. The room that kernels keep for it, its
array on disk with type, unit, dimensions and description, its size in bytes, and what sessions
record follow from that. Its value is one expression in its phase.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, Literal

import jax
import numpy as np

SIZES = {"xyz": 3, "wxyz": 4, "uvwpqr": 6, "xyzkmn": 6}
"""Axes that are as long in every run; those of robots, obstacles, thrusters and joints of vehicles
are the run's."""

JOINT_AXIS = "vehicle_joint"
"""Axis of the joints of vehicles; ``joint`` is that of plans."""

ACOUSTICS = "acoustics"
"""Group of what robots heard of each other."""

CLEARANCE = "clearance"
"""Group of the distances to what is near."""

ESTIMATE = "estimate"
"""Group of what the controllers were told, where that was not the truth."""

GRIPS = "grips"
"""Group of what robots that hold a body together measure of it."""

TASK = "task"
"""Group of how far the task is."""

type PhaseName = Literal[
    "sense", "hear", "work", "policy", "decide", "move", "obstacles", "judge", "sample"
]
"""``sample`` computes it from the rest of a sample (`angler_mjx.sim.sample_clearances`)."""

type RecordOption = Literal["wrench", "clearance", "acoustics", "grips"]
"""What is recorded only where it is asked for."""


@dataclass(frozen=True, kw_only=True)
class FieldMetadata:
    """What is said of a recorded field where it is declared."""

    phase: PhaseName
    """Gives it."""
    array: str
    """Its name on disk."""
    axes: tuple[str, ...]
    """``robot`` or ``obstacle`` first, neither for what is of a world; then what `SIZES` names,
    ``thruster`` or `JOINT_AXIS`."""
    unit: str
    text: str
    """What it is, with its frame; in the array's attributes."""
    whole: bool = False
    """Whether it is int32 in `Sample`, not a number of the simulation's type."""
    stored: str = "float32"
    """Type on disk."""
    none: float | None = None
    """Least value, which stands on disk where there is none; NaN does if this is not given."""
    state: bool = False
    """Whether it is of the state, so that it is kept once more after the last sample."""
    option: RecordOption | None = None
    """By which word it has to be asked for; None for what all runs have."""


def _field_metadata(
    phase: PhaseName, array: str, axes: str, unit: str, text: str, **more: Any
) -> dict[str, FieldMetadata]:
    """Metadata of a field: what `FieldMetadata` says, the axes with blanks between."""
    names = tuple(axes.split())
    return {
        "about": FieldMetadata(phase=phase, array=array, axes=names, unit=unit, text=text, **more)
    }


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Belief:
    """What the controllers of the robots are told of their own motion; [R] leads.

    Standard deviations are zero where they are told the truth.
    """

    p: jax.Array = field(
        metadata=_field_metadata(
            "sense",
            f"{ESTIMATE}/p_m",
            "robot xyz",
            "m",
            "centre of mass as the controllers were told it, world frame",
        )
    )
    """[R, 3] m in W."""
    q: jax.Array = field(
        metadata=_field_metadata(
            "sense",
            f"{ESTIMATE}/q",
            "robot wxyz",
            "1",
            "attitude as they were told it, quaternion wxyz, body to world",
        )
    )
    """[R, 4]."""
    nu: jax.Array = field(
        metadata=_field_metadata(
            "sense",
            f"{ESTIMATE}/nu",
            "robot uvwpqr",
            "m/s, rad/s",
            "velocity over ground as they were told it, body frame",
        )
    )
    """[R, 6] in F."""
    flow: jax.Array | None
    """[R, 3] current, m/s in W; None where nobody wants it. Zero, still water, from a filter."""
    position_std_m: jax.Array = field(
        metadata=_field_metadata(
            "sense",
            f"{ESTIMATE}/position_std_m",
            "robot xyz",
            "m",
            "standard deviations of the estimate, world frame; 0 for the truth",
        )
    )
    """[R, 3] along the axes of W, as the two that follow."""
    velocity_std_mps: jax.Array = field(
        metadata=_field_metadata(
            "sense",
            f"{ESTIMATE}/velocity_std_mps",
            "robot xyz",
            "m/s",
            "standard deviations of the velocity, world frame",
        )
    )
    """[R, 3]"""
    attitude_std_rad: jax.Array = field(
        metadata=_field_metadata(
            "sense",
            f"{ESTIMATE}/attitude_std_rad",
            "robot xyz",
            "rad",
            "standard deviations of the attitude, about the world's axes",
        )
    )
    """[R, 3] about the axes."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class JointRecord:
    """Motion of the joints of the robots' arms; [R] leads."""

    position: jax.Array = field(
        metadata=_field_metadata(
            "move",
            "joint_position",
            f"robot {JOINT_AXIS}",
            "rad, m",
            "position of each joint, in m of a prismatic one; names and units by vehicle are in "
            "the attribute joints; NaN of a robot without joints",
            state=True,
        )
    )
    """[R, J] rad or m."""
    velocity: jax.Array = field(
        metadata=_field_metadata(
            "move",
            "joint_velocity",
            f"robot {JOINT_AXIS}",
            "rad/s, m/s",
            "speed of each joint; as joint_position",
            state=True,
        )
    )
    """[R, J] rad/s or m/s."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AcousticsRecord:
    """What came of the packets that robots sent; [R] leads."""

    fraction: jax.Array = field(
        metadata=_field_metadata(
            "hear",
            f"{ACOUSTICS}/share",
            "robot",
            "1",
            "share of the packets of the others so far that the robot understood; NaN before any",
            option="acoustics",
        )
    )
    """[R]"""
    age_s: jax.Array = field(
        metadata=_field_metadata(
            "hear",
            f"{ACOUSTICS}/age_s",
            "robot",
            "s",
            "age of what the robot knows of the others, mean over these; since the start of whom "
            "it has not heard; NaN in a fleet of one",
            option="acoustics",
        )
    )
    """[R]"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GripRecord:
    """Grips of robots that hold a body together; [R] leads."""

    held: jax.Array = field(
        metadata=_field_metadata(
            "move",
            f"{GRIPS}/held",
            "robot",
            "1",
            "1 where the robot holds the body",
            whole=True,
            stored="uint8",
            option="grips",
        )
    )
    """int32 [R]."""
    wrench: jax.Array = field(
        metadata=_field_metadata(
            "move",
            f"{GRIPS}/wrench",
            "robot xyzkmn",
            "N, N m",
            "force and moment [X Y Z K M N] of the body on the robot about its centre of mass, "
            "body frame: mean of the control period before the sample, without noise",
            option="grips",
        )
    )
    """[R, 6] in F."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ProgressRecord:
    """How far the task of a world is, and who does what."""

    fraction: jax.Array = field(
        metadata=_field_metadata(
            "work",
            f"{TASK}/share",
            "",
            "1",
            "share of the task that is done; of a survey, share of its cells that were seen",
        )
    )
    """[]"""
    target: jax.Array = field(
        metadata=_field_metadata(
            "work",
            f"{TASK}/target",
            "robot",
            "1",
            "place that each robot goes to, in the order of environment/task_place_m; -1: it stays",
            whole=True,
            stored="int16",
        )
    )
    """int32 [R]."""
    carrying: jax.Array = field(
        metadata=_field_metadata(
            "work",
            f"{TASK}/carrying",
            "robot",
            "1",
            "job whose goods each robot carries; -1 for none",
            whole=True,
            stored="int16",
        )
    )
    """int32 [R]."""
    done: jax.Array = field(
        metadata=_field_metadata(
            "work",
            f"{TASK}/done",
            "robot",
            "1",
            "jobs that each robot did so far; where a tour is not shared, places that it visited",
            whole=True,
            stored="int16",
        )
    )
    """int32 [R]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Clearance:
    """Distances of the hulls at the sample, negative where they overlap; [R] leads."""

    rock_m: jax.Array = field(
        metadata=_field_metadata(
            "sample",
            f"{CLEARANCE}/rock_m",
            "robot",
            "m",
            "distance of the hull to rock and sea floor; at most the edge of a cell less the "
            "radius of the hull, negative where it overlaps",
            option="clearance",
        )
    )
    """[R]"""
    obstacle_m: jax.Array = field(
        metadata=_field_metadata(
            "sample",
            f"{CLEARANCE}/obstacle_m",
            "robot",
            "m",
            "distance of the hull to the nearest obstacle, negative where it overlaps; inf where "
            "there is none",
            option="clearance",
        )
    )
    """[R]"""
    robot_m: jax.Array = field(
        metadata=_field_metadata(
            "sample",
            f"{CLEARANCE}/robot_m",
            "robot",
            "m",
            "distance of the hull to the nearest other hull, at most 1, negative where they "
            "overlap; inf in a fleet of one",
            option="clearance",
        )
    )
    """[R]"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Sample:
    """One record of one world: the truth and the command at one time."""

    p: jax.Array = field(
        metadata=_field_metadata(
            "move",
            "p_m",
            "robot xyz",
            "m",
            "centre of mass, world frame (x east, y north, z up, 0 at the surface)",
            state=True,
        )
    )
    """[R, 3] m in W."""
    q: jax.Array = field(
        metadata=_field_metadata(
            "move",
            "q",
            "robot wxyz",
            "1",
            "attitude, quaternion wxyz, body (forward, left, up) to world",
            state=True,
        )
    )
    """[R, 4]."""
    nu: jax.Array = field(
        metadata=_field_metadata(
            "move",
            "nu",
            "robot uvwpqr",
            "m/s, rad/s",
            "velocity over ground [u v w p q r], body frame",
            state=True,
        )
    )
    """[R, 6] in F."""
    target_m: jax.Array = field(
        metadata=_field_metadata(
            "decide", "target_m", "robot xyz", "m", "where the controller aims, world frame"
        )
    )
    """[R, 3] where the controller aims, in W; the robot itself where it aims at no place."""
    current_mps: jax.Array = field(
        metadata=_field_metadata(
            "move", "current_mps", "robot xyz", "m/s", "water velocity at the robot, world frame"
        )
    )
    """[R, 3] water velocity at the robot, in W."""
    pwm_us: jax.Array = field(
        metadata=_field_metadata(
            "decide",
            "pwm_us",
            "robot thruster",
            "us",
            "command of each thruster; 1500 in padding columns, 0 where there was none: of a robot "
            "that diverged, and after all robots of the tile had ended",
            none=0.0,
        )
    )
    """[R, n_thruster] command of the control step that begins here."""
    outcome: jax.Array = field(
        metadata=_field_metadata(
            "move",
            "outcome",
            "robot",
            "1",
            "0 running, 1 reached, 2 collision_static, 3 collision_dynamic, "
            "4 collision_robot, 5 out_of_bounds, 6 timeout, 7 diverged, 8 failed, 9 damaged, "
            "10 dropped",
            whole=True,
            stored="uint8",
            state=True,
        )
    )
    """int32 [R]."""
    obstacle_p: jax.Array = field(
        metadata=_field_metadata(
            "obstacles",
            "obstacle_p_m",
            "obstacle xyz",
            "m",
            "centre of each obstacle, world frame",
            state=True,
        )
    )
    """[n_obstacle, 3] m in W."""
    obstacle_q: jax.Array = field(
        metadata=_field_metadata(
            "obstacles",
            "obstacle_q",
            "obstacle wxyz",
            "1",
            "attitude of each obstacle, quaternion wxyz, body to world",
            state=True,
        )
    )
    """[n_obstacle, 4]."""
    belief: Belief | None = field(default=None, metadata={"parts": Belief})
    """What the controllers were told; None where all are told the truth."""
    wrench: jax.Array | None = field(
        default=None,
        metadata=_field_metadata(
            "move",
            "wrench",
            "robot xyzkmn",
            "N, N m",
            "force and moment [X Y Z K M N] of the thrusters about the centre of mass, body frame, "
            "at the sample: behind the lag of the rotors, before the new signals act; NaN of a "
            "robot that diverged",
            option="wrench",
        ),
    )
    """[R, 6] in F, where it is asked for."""
    clearance: Clearance | None = field(default=None, metadata={"parts": Clearance})
    """Distances to what is near, where they are asked for."""
    talk: AcousticsRecord | None = field(default=None, metadata={"parts": AcousticsRecord})
    """What was heard, where it is asked for."""
    task: ProgressRecord | None = field(default=None, metadata={"parts": ProgressRecord})
    """How far the task is; None where each robot has a goal of its own."""
    joints: JointRecord | None = field(default=None, metadata={"parts": JointRecord})
    """Motion of the joints; None where no vehicle of the fleet has any."""
    grips: GripRecord | None = field(default=None, metadata={"parts": GripRecord})
    """Grips of robots that hold a body together, where they are asked for."""


@dataclass(frozen=True, kw_only=True)
class RecordedField:
    """A recorded field, as it is declared in `Sample`."""

    path: tuple[str, ...]
    """Names of attributes, from the sample down."""
    about: FieldMetadata

    @property
    def is_optional(self) -> bool:
        """Whether samples of some runs do not have it."""
        return len(self.path) > 1 or self.about.option is not None

    def is_recorded(self, also: Sequence[str]) -> bool:
        """Whether it needs no asking, or is asked for by one of these words."""
        return self.about.option is None or self.about.option in also

    @property
    def stored(self) -> np.dtype:
        """Type on disk."""
        return np.dtype(self.about.stored)

    def of(self, sample: Any) -> Any:
        """Its value in a `Sample`, or in what has it by the same name; None where there is none."""
        return reduce(lambda part, name: part and getattr(part, name), self.path, sample)

    def shape(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """Lengths of its axes, those of robots, obstacles, thrusters and joints being given."""
        return tuple({**SIZES, **sizes}[axis] for axis in self.about.axes)

    def element_shape(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """The same of one robot, one obstacle, or one world."""
        axes = [axis for axis in self.about.axes if axis not in ("robot", "obstacle")]
        return tuple({**SIZES, **sizes}[axis] for axis in axes)


def _collect_fields(kind: type, above: tuple[str, ...] = ()) -> tuple[RecordedField, ...]:
    collected: list[RecordedField] = []
    for declared in dataclasses.fields(kind):
        path = (*above, declared.name)
        if "about" in declared.metadata:
            collected.append(RecordedField(path=path, about=declared.metadata["about"]))
        elif "parts" in declared.metadata:
            collected += _collect_fields(declared.metadata["parts"], path)
    return tuple(collected)


FIELDS: tuple[RecordedField, ...] = _collect_fields(Sample)
"""All of them, in the order of their declarations."""

STATE_FIELDS: tuple[RecordedField, ...] = tuple(one for one in FIELDS if one.about.state)
"""Those of the state."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldRecord:
    """Fields of a sample that phases of worlds record; None where they record nothing."""

    belief: Belief | None = None
    talk: AcousticsRecord | None = None
    task: ProgressRecord | None = None


def build_sample(
    worlds: WorldRecord, bodies: Mapping[str, jax.Array | JointRecord | GripRecord]
) -> Sample:
    """Return the sample of what phases of worlds, and of robots and obstacles, recorded."""
    recorded: dict[str, Any] = {**vars(worlds), **bodies}
    return Sample(**recorded)


def of_phase(phase: str, also: Sequence[str] = ()) -> tuple[RecordedField, ...]:
    """Those of the sample itself that a phase gives by their names, ``also`` being asked for."""
    return tuple(
        entry
        for entry in FIELDS
        if entry.about.phase == phase and len(entry.path) == 1 and entry.is_recorded(also)
    )


def recorded_options(sample: Sample) -> tuple[RecordOption, ...]:
    """What was asked for of a sample that has it."""
    options = (entry.about.option for entry in FIELDS if entry.of(sample) is not None)
    return tuple(dict.fromkeys(option for option in options if option is not None))


def sizes_of(sample: Sample, lead: int) -> dict[str, int]:
    """Numbers of robots, obstacles, thrusters and joints of a sample, ``lead`` axes in front."""
    sizes: dict[str, int] = {}
    for entry in FIELDS:
        if (value := entry.of(sample)) is not None:
            sizes.update(zip(entry.about.axes, value.shape[lead:], strict=True))
    return {name: size for name, size in sizes.items() if name not in SIZES}
