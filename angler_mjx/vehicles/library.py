"""Finding and reading vehicle files and thruster files: those shipped here, and the user's own."""

from collections.abc import Iterable
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse, read_toml
from angler_mjx.vehicles.config import ThrusterTable, VehicleConfig

_VEHICLES = Path(__file__).parent / "data"
_THRUSTERS = _VEHICLES / "thrusters"


def available() -> list[str]:
    """Names of the shipped vehicles, sorted."""
    return _names(_VEHICLES)


def load(name_or_path: str) -> VehicleConfig:
    """Read a vehicle file.

    Args:
        name_or_path: Name of a shipped vehicle, or a path that ends in ``.toml``.

    Raises:
        ConfigError: there is no such vehicle, or its file has faults (all are listed).
    """
    path = _locate(name_or_path, _VEHICLES, "vehicle")
    config = _read(VehicleConfig, path)
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
    return _read(ThrusterTable, _locate(name_or_path, _THRUSTERS, "thruster"))


def _names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.toml"))


def _locate(name_or_path: str, folder: Path, kind: str) -> Path:
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    if name_or_path not in _names(folder):
        raise ConfigError(
            f"unknown {kind} {name_or_path!r}; there is {', '.join(_names(folder))}, "
            "or give the path of a .toml file"
        )
    return folder / f"{name_or_path}.toml"


def _read[M: FileModel](model: type[M], path: Path) -> M:
    return parse(model, read_toml(path), source=str(path))
