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
from angler_mjx.testing.referee.servos import RefereeServos, read_servos

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
    """Power of the thrusters by their voltage."""

    voltage_v: Floats
    """[v]."""
    pwm_us: Floats
    """[n] rows of the thruster file."""
    thrust_n: Floats
    """[n, v]."""
    power_w: Floats
    """[n, v]."""
    curves: tuple[tuple[Floats, Floats] | None, ...]
    """Signals and thrusts of the curve of each thruster [t]; None where the file's hold."""

    @property
    def signal_us(self) -> Floats:
        """Return the signals [m] of `power_at`: the file's, or those in steps of 4 us."""
        if all(curve is None for curve in self.curves):
            return self.pwm_us
        return np.arange(1100.0, 1901.0, 4.0)

    def power_at(self, voltage_v: float) -> Floats:
        """Return power [m] W of all thrusters at one voltage, or [t, m] where they have curves.

        Between columns of the file linear. A thruster with a curve takes what the file says at its
        thrust; beyond the file, power grows as the 3/2 of the thrust.
        """
        power, thrust = (
            _interpolate_column(self.voltage_v, table, voltage_v)
            for table in (self.power_w, self.thrust_n)
        )
        if all(curve is None for curve in self.curves):
            return power
        rows = [
            np.interp(self.signal_us, self.pwm_us, power)
            if curve is None
            else _power_of_thrust(np.interp(self.signal_us, *curve), thrust, power)
            for curve in self.curves
        ]
        return np.array(rows)


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


_NO_THRUSTER: dict[str, Any] = {
    "voltage_v": [0.0, 1e6],
    "pwm_us": [1100.0, 1900.0],
    "thrust_n": [[0.0, 0.0], [0.0, 0.0]],
    "power_w": [[0.0, 0.0], [0.0, 0.0]],
}
"""Table of vehicles without thrusters."""


@dataclass(frozen=True, kw_only=True)
class RefereeRobot:
    """One robot of the fleet."""

    names: tuple[str, ...]
    """Names of its vehicle: in the scenario, and in its file."""
    parameter_sets: tuple[str, ...]
    """Possible parameter sets."""
    hull: RefereeHull
    pwm_us: Floats
    """[n] signals of ``power_w``."""
    power_w: Floats
    """[n] of every thruster at the robot's voltage, or [t, n] of each."""
    alive: np.ndarray
    """bool [t] the thrusters that exist and are not dead: only they draw power."""
    thruster: ThrusterPower
    servos: RefereeServos
    """Tanks and moving masses; none of most vehicles."""

    def with_variant(self, variant: StoredVariant) -> "RefereeRobot":
        """Return the robot with a row of ``variants.json``: hulls are never sampled."""
        alive = self.alive
        if variant["drawn"].get("thrust"):
            alive = alive & (np.asarray(variant["drawn"]["thrust"], float) > 0.0)
        return replace(
            self, power_w=self.thruster.power_at(float(variant["battery_v"])), alive=alive
        )

    def _single_power(self, signals: Floats) -> Floats:
        """Return power [..., a] W of the signals of the thrusters that are alive."""
        if self.power_w.ndim == 1:
            alike: Floats = np.interp(signals, self.pwm_us, self.power_w)
            return alike
        rows = self.power_w[self.alive]
        each = [np.interp(signals[..., i], self.pwm_us, row) for i, row in enumerate(rows)]
        return np.stack(each, axis=-1)

    def power(self, pwm_us: Floats) -> Floats:
        """Return power [...] W of signals [..., columns]; those past the thrusters are padding."""
        signals = pwm_us[..., : self.alive.size][..., self.alive]
        total_w: Floats = self._single_power(signals).sum(axis=-1)
        return total_w

    def power_bounds(self, pwm_us: Floats, half_us: float) -> tuple[Floats, Floats]:
        """Return min and max power [...] W of signals known to ``half_us`` to either side."""
        signals = pwm_us[..., : self.alive.size][..., self.alive]
        # The table is monotonous between its points; points inside the interval count as well.
        powers = [self._single_power(signals + s) for s in (-half_us, 0.0, half_us)]
        knots = self.power_w if self.power_w.ndim == 1 else self.power_w[self.alive].T
        for knot, power in zip(self.pwm_us, knots, strict=True):
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
        table = _NO_THRUSTER
        if file["thrusters"]["layout"]:
            model = str(file["rotor"]["model"])
            table = _read_toml(
                path.parent / model if model.endswith(".toml") else _shipped_thruster(model)
            )
        thruster = ThrusterPower(
            voltage_v=np.asarray(table["voltage_v"], float),
            pwm_us=np.asarray(table["pwm_us"], float),
            thrust_n=np.asarray(table["thrust_n"], float),
            power_w=np.asarray(table["power_w"], float),
            curves=tuple(map(_read_curve, file["thrusters"]["layout"])),
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
            pwm_us=thruster.signal_us,
            power_w=thruster.power_at(float(entry["battery_v"])),
            alive=np.array([health.get(name, 1.0) > 0.0 for name in names], bool),
            thruster=thruster,
            servos=read_servos(file),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        message = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ConfigError(f"{path}: the referee cannot use it: {message}") from error


def _read_curve(thruster: Mapping[str, Any]) -> tuple[Floats, Floats] | None:
    curve = thruster.get("curve")
    if curve is None:
        return None
    return np.asarray(curve["pwm_us"], float), np.asarray(curve["thrust_n"], float)


def _power_of_thrust(thrust_n: Floats, file_n: Floats, file_w: Floats) -> Floats:
    """Return the power [m] W at thrusts [m] N by rows [n] of a file, whose thrust never falls."""
    result = np.empty_like(thrust_n)
    for i, thrust in enumerate(thrust_n):
        low, high = file_n[0], file_n[-1]
        if thrust < low:
            result[i] = file_w[0] * (thrust / low) ** 1.5
        elif thrust > high:
            result[i] = file_w[-1] * (thrust / high) ** 1.5
        elif np.any(file_n == thrust):
            result[i] = file_w[file_n == thrust].min()
        else:
            right = int(np.argmax(file_n > thrust))
            left_n, right_n = file_n[right - 1], file_n[right]
            left_w, right_w = (file_w[file_n == end].min() for end in (left_n, right_n))
            result[i] = left_w + (right_w - left_w) * (thrust - left_n) / (right_n - left_n)
    return result


def _interpolate_column(volts: Floats, power: Floats, voltage_v: float) -> Floats:
    """Return values [n] at one voltage, interpolated linearly between the two nearest columns."""
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
