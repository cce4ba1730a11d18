"""Reader of vehicle and thruster files for the referee: the hull, and the thrusters' power."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.testing.referee.arms import RefereeArm, read_arm
from angler_mjx.testing.referee.geometry import Floats

SHIPPED_FOLDER = Path(__file__).parents[2] / "robot" / "vehicles" / "data"


@dataclass(frozen=True, kw_only=True)
class RefereeHull:
    """Union of capsules about the centre of mass, in body axes (forward, left, up)."""

    a_m: Floats
    """[c, 3] one end of each axis."""
    b_m: Floats
    """[c, 3] the other end."""
    r_m: Floats
    """[c]."""
    arm: RefereeArm | None = None
    """Links that belong to the hull as they lie; None for a vehicle without any."""

    def locate_capsules(self, joints: Floats | None) -> tuple[Floats, Floats, Floats]:
        """Return the ends [S, c, 3] of all capsules' axes, and their radii [c].

        Args:
            joints: [S, J] of the record; None where there is none: S is 1, without the arm.
        """
        if self.arm is None or joints is None:
            return self.a_m[None], self.b_m[None], self.r_m
        shape = (len(joints), *self.a_m.shape)
        a, b = self.arm.locate_capsules(joints)
        return (
            np.concatenate([np.broadcast_to(self.a_m, shape), a], axis=1),
            np.concatenate([np.broadcast_to(self.b_m, shape), b], axis=1),
            np.concatenate([self.r_m, self.arm.r_m]),
        )


@dataclass(frozen=True, kw_only=True)
class ThrusterPower:
    """Power of a thruster by its voltage."""

    voltage_v: Floats
    """[v]."""
    power_w: Floats
    """[n, v]; n as the signals."""


class FleetTable(TypedDict):
    """Entry of ``fleet`` in ``config.json``."""

    vehicle: str
    battery_v: float
    thruster_health: NotRequired[Mapping[str, float] | None]
    parameter_set: NotRequired[str | None]
    parameter_mix: NotRequired[Mapping[str, float] | None]


StoredVariant = TypedDict(  # noqa: UP013 - keys of files are no names
    "StoredVariant", {"battery_v": float, "drawn": Mapping[str, Sequence[float]]}
)
"""Row of ``variants.json``: voltage, and sampled values by name."""


@dataclass(frozen=True, kw_only=True)
class RefereeRobot:
    """One robot of the fleet."""

    names: tuple[str, ...]
    """Names of its vehicle: in the scenario, and in its file."""
    parameter_sets: tuple[str, ...]
    """Possible parameter sets."""
    hull: RefereeHull
    pwm_us: Floats
    """[n] of the thruster's table."""
    power_w: Floats
    """[n] at the robot's voltage."""
    alive: np.ndarray
    """bool [t] the thrusters that exist and are not dead: only they draw power."""
    thruster: ThrusterPower

    def with_variant(self, variant: StoredVariant) -> "RefereeRobot":
        """Return the robot with a row of ``variants.json``: hulls are never sampled."""
        alive = self.alive
        if variant["drawn"].get("thrust"):
            alive = alive & (np.asarray(variant["drawn"]["thrust"], float) > 0.0)
        return replace(
            self, power_w=_power_at_voltage(self.thruster, float(variant["battery_v"])), alive=alive
        )

    def power(self, pwm_us: Floats) -> Floats:
        """Return power [...] W of signals [..., columns]; those past the thrusters are padding."""
        signals = pwm_us[..., : self.alive.size][..., self.alive]
        total_w: Floats = np.interp(signals, self.pwm_us, self.power_w).sum(axis=-1)
        return total_w

    def power_bounds(self, pwm_us: Floats, half_us: float) -> tuple[Floats, Floats]:
        """Return min and max power [...] W of signals known to ``half_us`` to either side."""
        signals = pwm_us[..., : self.alive.size][..., self.alive]
        # The table is monotonous between its points; points inside the interval count as well.
        powers = [
            np.interp(signals + s, self.pwm_us, self.power_w) for s in (-half_us, 0.0, half_us)
        ]
        for knot, power in zip(self.pwm_us, self.power_w, strict=True):
            powers.append(np.where(np.abs(signals - knot) <= half_us, power, powers[1]))
        low: Floats = np.minimum.reduce(powers).sum(axis=-1)
        high: Floats = np.maximum.reduce(powers).sum(axis=-1)
        return low, high


def read_robot(entry: FleetTable, copies: Mapping[str, Path]) -> RefereeRobot:
    """Read the robot of an entry of ``fleet`` in a run's config.

    Args:
        entry: of the resolved scenario.
        copies: files of the run, by their names in the scenario.

    Raises:
        ConfigError: a file is missing or lacks these numbers; names the file.
    """
    path = _find_file(str(entry["vehicle"]), copies)
    file = _read_toml(path)
    try:
        model = str(file["rotor"]["model"])
        table = _read_toml(
            path.parent / model if model.endswith(".toml") else _shipped_thruster(model)
        )
        thruster = ThrusterPower(
            voltage_v=np.asarray(table["voltage_v"], float),
            power_w=np.asarray(table["power_w"], float),
        )
        centre = np.asarray(file["base"]["center_of_mass_m"], float)
        capsules = file["hull"]["capsules"]
        health = entry.get("thruster_health") or {}
        names = [str(item["name"]) for item in file["thrusters"]["layout"]]
        parameter_set = str(entry.get("parameter_set") or file["default_set"])
        return RefereeRobot(
            names=(str(entry["vehicle"]), str(file["name"])),
            parameter_sets=tuple(entry.get("parameter_mix") or ()) or (parameter_set,),
            hull=RefereeHull(
                a_m=np.array([item["from_m"] for item in capsules], float) - centre,
                b_m=np.array([item["to_m"] for item in capsules], float) - centre,
                r_m=np.array([item["radius_m"] for item in capsules], float),
                arm=read_arm(file),
            ),
            pwm_us=np.asarray(table["pwm_us"], float),
            power_w=_power_at_voltage(thruster, float(entry["battery_v"])),
            alive=np.array([health.get(name, 1.0) > 0.0 for name in names]),
            thruster=thruster,
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        message = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ConfigError(f"{path}: the referee cannot use it: {message}") from error


def _power_at_voltage(thruster: ThrusterPower, voltage_v: float) -> Floats:
    """Return power [n] W at one voltage, interpolated linearly between the two nearest columns."""
    volts, power = thruster.voltage_v, thruster.power_w
    if not volts[0] <= voltage_v <= volts[-1]:
        raise ValueError(f"battery_v = {voltage_v:g}: its thruster's table ends before")
    right = int(np.clip(np.searchsorted(volts, voltage_v), 1, volts.size - 1))
    fraction = (voltage_v - volts[right - 1]) / (volts[right] - volts[right - 1])
    between: Floats = (1.0 - fraction) * power[:, right - 1] + fraction * power[:, right]
    return between


def _find_file(name: str, copies: Mapping[str, Path]) -> Path:
    """Return a vehicle's file: the run's copy, the path itself, or the shipped one."""
    if name in copies:
        return copies[name]
    return Path(name) if name.endswith(".toml") else SHIPPED_FOLDER / f"{name}.toml"


def _shipped_thruster(thruster: str) -> Path:
    return SHIPPED_FOLDER / "thrusters" / f"{thruster}.toml"


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(
            f"{path}: cannot be read ({error}); the referee needs the vehicle and thruster files "
            "that the run was flown with"
        ) from error
