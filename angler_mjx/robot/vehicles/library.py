"""Finding and reading vehicle files and thruster files: those shipped here, and the user's own."""

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError, shown
from angler_mjx.files import TOML_BYTES, named, parse, read_text, toml_of
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable

_VEHICLES = Path(__file__).parent / "data"
_THRUSTERS = _VEHICLES / "thrusters"


def available() -> list[str]:
    """Names of the shipped vehicles, sorted."""
    return list(_names(_VEHICLES))


def load(name_or_path: str) -> VehicleConfig:
    """Read a vehicle file.

    Args:
        name_or_path: Name of a shipped vehicle, or a path that ends in ``.toml``.

    Raises:
        ConfigError: there is no such vehicle, or its file has faults (all are listed).
    """
    path = _locate(name_or_path, _VEHICLES, "vehicle")
    return _load(path, read_text(path, TOML_BYTES))


@lru_cache(maxsize=64)
def _load(path: Path, text: str) -> VehicleConfig:
    """Of a file with this text: a scenario asks for the same one many times."""
    config = parse(VehicleConfig, toml_of(text, named(path)), source=str(path))
    if not config.rotor.model.endswith(".toml"):
        return config
    # A path in a vehicle file means a file beside it, wherever the program was started.
    model = str((path.parent / config.rotor.model).resolve())
    return config.model_copy(update={"rotor": config.rotor.model_copy(update={"model": model})})


def locate(name_or_path: str) -> Path:
    """File of a vehicle; arguments and errors as in `load`."""
    return _locate(name_or_path, _VEHICLES, "vehicle")


def locate_thruster(name_or_path: str) -> Path:
    """File of a thruster; arguments and errors as in `load_thruster`."""
    return _locate(name_or_path, _THRUSTERS, "thruster")


def labels(vehicles: Iterable[str]) -> dict[str, str]:
    """What to call vehicles in tables: the names in their files, unless two files share one.

    Args:
        vehicles: as a scenario names them.

    Raises:
        ConfigError: a file cannot be read.
    """
    names = {named: load(named).name for named in vehicles}
    shared = {name for name in names.values() if list(names.values()).count(name) > 1}
    return {named: named if name in shared else name for named, name in names.items()}


def load_thruster(name_or_path: str) -> ThrusterTable:
    """Read a thruster file.

    Args:
        name_or_path: Name of a shipped thruster, or a path that ends in ``.toml``.

    Raises:
        ConfigError: there is no such thruster, or its file has faults (all are listed).
    """
    path = _locate(name_or_path, _THRUSTERS, "thruster")
    return _load_thruster(path, read_text(path, TOML_BYTES))


@lru_cache(maxsize=64)
def _load_thruster(path: Path, text: str) -> ThrusterTable:
    return parse(ThrusterTable, toml_of(text, named(path)), source=str(path))


def reach_m(config: VehicleConfig) -> float:
    """Radius of the smallest sphere about the centre of mass that holds the hull, m."""
    center = np.asarray(config.base.center_of_mass_m)
    return max(
        float(np.linalg.norm(np.asarray(end) - center)) + capsule.radius_m
        for capsule in config.hull.capsules
        for end in (capsule.from_m, capsule.to_m)
    )


@lru_cache
def _names(folder: Path) -> tuple[str, ...]:
    """Of the files that are shipped, which do not change."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def _locate(name_or_path: str, folder: Path, kind: str) -> Path:
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    if name_or_path not in _names(folder):
        raise ConfigError(
            f"unknown {kind} {shown(name_or_path)}; there is {', '.join(_names(folder))}, "
            "or give the path of a .toml file"
        )
    return folder / f"{name_or_path}.toml"
