"""Vehicle files and thruster files: lookup and reading of shipped files and of the user's own."""

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import MAX_TOML_BYTES, format_path, parse_model, parse_toml, read_text
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable

_VEHICLES = Path(__file__).parent / "data"
_THRUSTERS = _VEHICLES / "thrusters"


def list_vehicles() -> list[str]:
    """List the names of the shipped vehicles, sorted."""
    return list(_list_names(_VEHICLES))


@lru_cache
def list_rovs() -> tuple[str, ...]:
    """List the names of the shipped vehicles that ArduSub has a frame for, sorted."""
    return tuple(name for name in list_vehicles() if load_vehicle(name).ardusub is not None)


def load_vehicle(name_or_path: str) -> VehicleConfig:
    """Read a vehicle file.

    Args:
        name_or_path: Name of a shipped vehicle, or a path that ends in ``.toml``.

    Raises:
        ConfigError: there is no such vehicle, or its file has faults (all are listed).
    """
    path = _locate_file(name_or_path, _VEHICLES, "vehicle")
    return _parse_vehicle(path, read_text(path, MAX_TOML_BYTES))


@lru_cache(maxsize=64)
def _parse_vehicle(path: Path, text: str) -> VehicleConfig:
    """Parse a vehicle file of this text, cached: a scenario loads the same file many times."""
    config = parse_model(VehicleConfig, parse_toml(text, format_path(path)), source=str(path))
    if config.rotor is None or not config.rotor.model.endswith(".toml"):
        return config
    # A path in a vehicle file means a file beside it, wherever the program was started.
    model = str((path.parent / config.rotor.model).resolve())
    return config.model_copy(update={"rotor": config.rotor.model_copy(update={"model": model})})


def locate_vehicle(name_or_path: str) -> Path:
    """Return the file of a vehicle; arguments and errors as in `load_vehicle`."""
    return _locate_file(name_or_path, _VEHICLES, "vehicle")


def locate_thruster(name_or_path: str) -> Path:
    """Return the file of a thruster; arguments and errors as in `load_thruster`."""
    return _locate_file(name_or_path, _THRUSTERS, "thruster")


def label_vehicles(vehicles: Iterable[str]) -> dict[str, str]:
    """Return table labels of vehicles: the names in their files, unless two files share a name.

    Args:
        vehicles: as a scenario names them.

    Raises:
        ConfigError: a file cannot be read.
    """
    names = {named: load_vehicle(named).name for named in vehicles}
    shared = {name for name in names.values() if list(names.values()).count(name) > 1}
    return {named: named if name in shared else name for named, name in names.items()}


def load_thruster(name_or_path: str) -> ThrusterTable:
    """Read a thruster file.

    Args:
        name_or_path: Name of a shipped thruster, or a path that ends in ``.toml``.

    Raises:
        ConfigError: there is no such thruster, or its file has faults (all are listed).
    """
    path = _locate_file(name_or_path, _THRUSTERS, "thruster")
    return _parse_thruster(path, read_text(path, MAX_TOML_BYTES))


@lru_cache(maxsize=64)
def _parse_thruster(path: Path, text: str) -> ThrusterTable:
    return parse_model(ThrusterTable, parse_toml(text, format_path(path)), source=str(path))


def reach_m(config: VehicleConfig) -> float:
    """Return the radius [m] of the smallest sphere about the centre of mass that holds the hull.

    Links lie in their home posture.
    """
    # Brings JAX, which commands that only read files do without.
    from angler_mjx.robot.vehicles.link_hull import home_link_reach_m

    center = np.asarray(config.base.center_of_mass_m)
    hull_m = max(
        float(np.linalg.norm(np.asarray(end) - center)) + capsule.radius_m
        for capsule in config.hull.capsules
        for end in (capsule.from_m, capsule.to_m)
    )
    return max(hull_m, home_link_reach_m(config))


@lru_cache
def _list_names(folder: Path) -> tuple[str, ...]:
    """List the names of shipped files, cached: they do not change."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def _locate_file(name_or_path: str, folder: Path, kind: str) -> Path:
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    if name_or_path not in _list_names(folder):
        raise ConfigError(
            f"unknown {kind} {format_value(name_or_path)}; there is "
            f"{', '.join(_list_names(folder))}, "
            "or give the path of a .toml file"
        )
    return folder / f"{name_or_path}.toml"
