"""Sea trials of a vehicle: which it can do, their programs, and all measures."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.params import VehicleParams, build_vehicle
from angler_mjx.robot.vehicles.properties import describe_vehicle
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.physics.step import Water
from angler_mjx.studies.sea_trials import measures
from angler_mjx.studies.sea_trials.actuators import Actuators, Axis, Command, build_actuators
from angler_mjx.studies.sea_trials.measures import Measure
from angler_mjx.studies.sea_trials.program import SAMPLE_S, TrialMotion, TrialProgram, simulate

APPROACH_TIME_CONSTANTS, MIN_APPROACH_S, MAX_APPROACH_S = 15.0, 10.0, 100.0
"""Time from rest to the beginning of a manoeuvre, in time constants of the terminal speeds."""
DURATION_APPROACHES = 4.0
"""Duration of a trial, in times of the approach."""
SWITCHES_DEG = (10, 20)
"""Changes of heading at which zig-zags reverse."""
SPIRAL_LEVELS = (1.0, 0.6, 0.3, 0.1, 0.0, -0.1, -0.3, -0.6, -1.0)
"""Steering of the spiral, as fractions of the steering of the turning circle."""
DECAY_DEG = 10.0
MIN_BUOYANCY_ARM_M = 1e-6
MAX_TILT_DEG = 60.0
"""Angle between the vehicle's vertical and the world's above which a vehicle tumbles: the measures
of a trial are those of a level vehicle."""
_LEVEL_AXES = (1.0, 1.0, 1.0, 0.0, 0.0, 1.0)
_PLANAR = "held: the vehicle is planar"
_SPEEDS: tuple[tuple[str, Axis, int], ...] = (
    ("surge ahead", "surge", 1),
    ("surge astern", "surge", -1),
    ("sway to port", "sway", 1),
    ("heave up", "heave", 1),
    ("heave down", "heave", -1),
    ("turning on the spot", "yaw", 1),
)


@dataclass(frozen=True, kw_only=True)
class TrialSettings:
    """Settings of the trials."""

    approach: float = 0.5
    """Surge of the approach, as a fraction of the greatest."""
    steer: float = 0.2
    """Steering, as a fraction of the greatest."""
    density_kgpm3: float = 1000.0
    level: bool = False
    """Whether roll and pitch are held, as a controller would hold them."""

    def __post_init__(self) -> None:
        """Refuse fractions that cannot be commanded.

        Raises:
            ConfigError: naming the flag and its value.
        """
        for name, value in (("approach", self.approach), ("steer", self.steer)):
            if not 0.0 < value <= 1.0:
                raise ConfigError(f"--{name} {value:g}: give a fraction above 0, at most 1")


@dataclass(frozen=True, kw_only=True)
class VehicleCheck:
    """Results of the trials."""

    vehicle: str
    parameter_set: str
    level: bool
    """Whether roll and pitch were held."""
    measures: tuple[Measure, ...]
    left_out: dict[str, str]
    """Reason why a trial was not done, by its name."""
    motions: dict[str, TrialMotion]
    """Motions by trial."""
    execute_index: int
    """Index of the sample at which manoeuvres begin."""
    spiral: FloatArray
    """[n, 3] steering, and steady yaw rates [deg/s] coming from port and from starboard; empty
    without."""


@dataclass(frozen=True, kw_only=True)
class _Trial:
    name: str
    program: TrialProgram
    measure: Callable[[TrialMotion], list[Measure]]

    @property
    def label(self) -> str:
        """Name in the table: the runs of the spiral are one trial."""
        return "spiral" if self.name.startswith("spiral") else self.name


def check_vehicle(
    config: VehicleConfig,
    *,
    parameter_set: str | None = None,
    voltage_v: float = 16.0,
    settings: TrialSettings | None = None,
    only: Sequence[str] = (),
) -> VehicleCheck:
    """Do all trials that a vehicle can do, in one batch.

    Args:
        config: the vehicle.
        parameter_set: name of a set; the default if left out.
        voltage_v: battery voltage.
        settings: of the trials.
        only: beginnings of the names of trials; all trials if empty.

    Raises:
        ConfigError: unknown set, a voltage outside the thruster's data, or no such trial.
    """
    settings = settings or TrialSettings()
    params = build_vehicle(config, parameter_set, voltage_v)
    if settings.level:
        params = _hold_level(params)
    actuators = build_actuators(config, voltage_v)
    approach_s = _choose_approach_s(config, parameter_set, voltage_v)
    trials, left_out = _list_trials(config, parameter_set, actuators, settings, approach_s)
    if only:
        trials = [trial for trial in trials if trial.name.startswith(tuple(only))]
        left_out = {name: why for name, why in left_out.items() if name.startswith(tuple(only))}
    if not trials:
        reasons = "; ".join(f"{name}: {why}" for name, why in left_out.items())
        raise ConfigError(
            f"--only {', '.join(only)}: no such trial is done{f' ({reasons})' if reasons else ''}"
        )
    water = Water(density_kgpm3=settings.density_kgpm3)
    motions = simulate(
        params,
        actuators,
        [trial.program for trial in trials],
        duration_s=DURATION_APPROACHES * approach_s,
        water=water,
    )
    found: list[Measure] = []
    by_name: dict[str, TrialMotion] = {}
    for trial, motion in zip(trials, motions, strict=True):
        fault = _find_fault(trial, motion)
        if fault is None:
            found += trial.measure(motion)
            by_name[trial.name] = motion
        else:
            left_out.setdefault(trial.label, fault)
    spiral = np.empty((0, 3)) if "spiral" in left_out else _collect_spiral(by_name)
    return VehicleCheck(
        vehicle=config.name,
        parameter_set=config.default_set if parameter_set is None else parameter_set,
        level=settings.level,
        measures=(*found, *_measure_spiral(spiral)),
        left_out=left_out,
        motions=by_name,
        execute_index=round(approach_s / SAMPLE_S),
        spiral=spiral,
    )


def _hold_level(params: VehicleParams) -> VehicleParams:
    """Return a vehicle whose roll and pitch are held."""
    axes = jnp.asarray(_LEVEL_AXES, params.D_l.dtype)
    return replace(params, free_axes=axes if params.free_axes is None else params.free_axes * axes)


def _find_fault(trial: _Trial, motion: TrialMotion) -> str | None:
    """Return why a motion has no measures; None if it has."""
    if not np.all(np.isfinite(motion.nu)):
        return "the motion diverges"
    over = np.flatnonzero(motion.tilt_rad > math.radians(MAX_TILT_DEG))
    if not over.size:
        return None
    speed = float(np.max(np.linalg.norm(motion.nu[: over[0] + 1, :3], axis=1)))
    reason = f"tumbles: tilts by more than {MAX_TILT_DEG:g} deg after reaching {speed:.2f} m/s"
    remedy = "give a smaller --approach or --level" if trial.program.execute_s else "give --level"
    return f"{reason}; {remedy}"


def _list_trials(
    config: VehicleConfig,
    parameter_set: str | None,
    actuators: Actuators,
    settings: TrialSettings,
    approach_s: float,
) -> tuple[list[_Trial], dict[str, str]]:
    """Return the trials that a vehicle can do, and why it cannot do the others."""
    trials: list[_Trial] = []
    left_out: dict[str, str] = {}
    still = np.zeros(actuators.effect.shape[1])
    for name, axis, sign in _SPEEDS:
        command = actuators.push(axis, sign)
        if config.planar and axis == "heave":
            left_out[name] = _PLANAR
            continue
        if command is None:
            left_out[name] = f"no actuator pushes in {axis} alone"
            continue
        trials.append(_speed_trial(name, axis, sign, command))
    ahead, astern = (actuators.push("surge", sign) for sign in (1, -1))
    port, starboard = (actuators.steer(sign) for sign in (1, -1))
    steered = ["turning circle to port", "turning circle to starboard"]
    steered += [f"zig-zag {degrees}/{degrees}" for degrees in SWITCHES_DEG] + ["spiral"]
    if ahead is None or port is None or starboard is None:
        lacking = "surge" if ahead is None else "yaw"
        left_out |= {name: f"no actuator pushes in {lacking}" for name in steered}
    else:
        approach = settings.approach * ahead
        trials += _steered_trials(
            approach,
            settings.steer * port,
            settings.steer * starboard,
            approach_s,
        )
    if ahead is None:
        left_out |= {
            name: "no actuator pushes in surge" for name in ("crash stop", "coasting stop")
        }
    else:
        approach = settings.approach * ahead
        trials.append(_stop_trial("coasting stop", approach, still, approach_s, coasts=True))
        if astern is None:
            left_out["crash stop"] = "no actuator pushes astern"
        else:
            trials.append(
                _stop_trial(
                    "crash stop", approach, settings.approach * astern, approach_s, coasts=False
                )
            )
    arm = config.find_set(parameter_set).buoyancy.center_of_buoyancy_m[2]
    for angle in ("roll", "pitch"):
        if config.planar or settings.level:
            left_out[f"{angle} decay"] = _PLANAR if config.planar else "held by --level"
        elif arm < MIN_BUOYANCY_ARM_M:
            left_out[f"{angle} decay"] = "nothing rights it"
        else:
            trials.append(_decay_trial(angle, still))
    return trials, left_out


def _choose_approach_s(config: VehicleConfig, parameter_set: str | None, voltage_v: float) -> float:
    """Return the time of the approach: the slowest axis comes to its terminal speed in it."""
    properties = describe_vehicle(config, parameter_set, voltage_v)
    constants, can = properties.speed_time_constant_s, properties.terminal_speed_mps > 0
    slowest = float(np.max(constants, where=can & np.isfinite(constants), initial=0.0))
    return float(np.clip(APPROACH_TIME_CONSTANTS * slowest, MIN_APPROACH_S, MAX_APPROACH_S).round())


def _speed_trial(name: str, axis: Axis, sign: int, command: Command) -> _Trial:
    return _Trial(
        name=name,
        program=TrialProgram(commands=((0.0, command),)),
        measure=lambda motion: measures.measure_speed(name, motion, axis, sign),
    )


def _steered_trials(
    approach: Command,
    port: Command,
    starboard: Command,
    approach_s: float,
) -> list[_Trial]:
    trials = []
    for side, steering in (("port", port), ("starboard", starboard)):
        trials.append(_turn_trial(f"turning circle to {side}", approach, steering, approach_s))
    for degrees in SWITCHES_DEG:
        trials.append(_zigzag_trial(degrees, approach, port, approach_s))
    for (side, steering), level in product(
        (("port", port), ("starboard", starboard)), SPIRAL_LEVELS
    ):
        level_steering = level * port if level >= 0 else -level * starboard
        program = TrialProgram(
            commands=(
                (0.0, approach),
                (approach_s, approach + steering),
                (2.0 * approach_s, approach + level_steering),
            ),
            execute_s=approach_s,
        )
        name = _spiral_name(side, level)
        trials.append(_Trial(name=name, program=program, measure=lambda _: []))
    return trials


def _turn_trial(name: str, approach: Command, steering: Command, approach_s: float) -> _Trial:
    return _Trial(
        name=name,
        program=TrialProgram(
            commands=((0.0, approach), (approach_s, approach + steering)),
            execute_s=approach_s,
        ),
        measure=lambda motion: measures.measure_turn(name, motion, approach_s),
    )


def _zigzag_trial(degrees: int, approach: Command, port: Command, approach_s: float) -> _Trial:
    name, switch_rad = f"zig-zag {degrees}/{degrees}", math.radians(degrees)
    return _Trial(
        name=name,
        program=TrialProgram(
            commands=((0.0, approach),),
            execute_s=approach_s,
            zigzag_by=port,
            switch_rad=switch_rad,
        ),
        measure=lambda motion: measures.measure_zigzag(name, motion, approach_s, switch_rad),
    )


def _stop_trial(
    name: str, approach: Command, after: Command, approach_s: float, *, coasts: bool
) -> _Trial:
    return _Trial(
        name=name,
        program=TrialProgram(commands=((0.0, approach), (approach_s, after)), execute_s=approach_s),
        measure=lambda motion: measures.measure_stop(name, motion, approach_s, coasts=coasts),
    )


def _decay_trial(axis: str, still: Command) -> _Trial:
    name, angle = f"{axis} decay", math.radians(DECAY_DEG)
    program = TrialProgram(
        commands=((0.0, still),),
        roll_rad=angle if axis == "roll" else 0.0,
        pitch_rad=angle if axis == "pitch" else 0.0,
    )
    return _Trial(
        name=name,
        program=program,
        measure=lambda motion: measures.measure_decay(
            name, motion.time_s, getattr(motion, f"{axis}_rad")
        ),
    )


def _spiral_name(side: str, level: float) -> str:
    return f"spiral from {side} {level:+g}"


def _collect_spiral(motions: dict[str, TrialMotion]) -> FloatArray:
    """Return steering and steady yaw rates of the spiral; see `VehicleCheck.spiral`."""
    rows = [
        (
            level,
            *(
                math.degrees(measures.average_end(motions[name].nu[:, 5])[0])
                for name in (_spiral_name("port", level), _spiral_name("starboard", level))
            ),
        )
        for level in SPIRAL_LEVELS
        if _spiral_name("port", level) in motions
    ]
    return np.array(rows).reshape(-1, 3)


def _measure_spiral(spiral: FloatArray) -> list[Measure]:
    if not spiral.size:
        return []
    (middle,) = np.flatnonzero(spiral[:, 0] == 0.0)
    _, from_port, from_starboard = spiral[middle]
    loop = abs(from_port - from_starboard)
    largest = float(np.max(np.abs(spiral[:, 1:])))
    note = "turns by itself" if loop > 0.01 * largest else "holds its course"
    left = int(np.argmax(spiral[:, 0]))
    right = int(np.argmin(spiral[:, 0]))
    return [
        Measure(
            trial="spiral",
            quantity="yaw rate, steered to port",
            value=float(spiral[left, 1]),
            unit="deg/s",
        ),
        Measure(
            trial="spiral",
            quantity="yaw rate, steered to starboard",
            value=float(spiral[right, 2]),
            unit="deg/s",
        ),
        Measure(
            trial="spiral",
            quantity="height of the loop, unsteered",
            value=float(loop),
            unit="deg/s",
            note=note,
        ),
    ]
