"""Registry of planners: entry points of this and other packages, and classes of files.

    auto                            grid or priority, resolved by the scenario
    grid, RRTConnect                an entry point of that name, in the group `GROUP`
    planners/straight.py:Straight   a class of a file

A class is loaded at its first use, so that missing libraries of a planner affect its users only.
"""

import hashlib
import importlib
import inspect
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from angler_mjx.errors import ConfigError, UnsupportedError, format_value
from angler_mjx.planning.planner import MAX_POINTS
from angler_mjx.planning.planner_choice import AUTO, AUTO_PLANNERS
from angler_mjx.user_classes import load_module

GROUP = "angler_mjx.planners"
"""Group of the entry points of planners: NAME = "module:Class"."""


@dataclass(frozen=True, kw_only=True)
class PlannerReference:
    """Location of a planner's class; can be sent to another process."""

    name: str
    """Name in the scenario."""
    module: str
    """Name of a module, or path of a file."""
    qualname: str
    """Name of the class in it."""
    sha256: str | None = None
    """SHA-256 of the file; None of a module."""
    text: bytes | None = field(default=None, repr=False, compare=False)
    """Text of the file when the planner was chosen; every process runs it, also after the file has
    changed."""

    @property
    def on_device(self) -> bool:
        """Return whether the class has ``plan_batch``; loads it, see `load`."""
        return callable(getattr(self.load(), "plan_batch", None))

    @property
    def is_built_in(self) -> bool:
        """Return whether the planner is part of this package."""
        return self.file is None and self.module.startswith("angler_mjx.")

    @property
    def file(self) -> Path | None:
        """The file; None of a module."""
        return Path(self.module) if self.sha256 is not None else None

    def load(self) -> type:
        """Return the class.

        Raises:
            ConfigError: there is no such class, or the file cannot be run.
            UnsupportedError: it needs a library that is not installed.
        """
        if self.sha256 is not None:
            module = load_module(self.module, self.text or b"")
        else:
            module = _import_module(self)
        value = module
        try:
            for part in self.qualname.split("."):
                value = getattr(value, part)
        except AttributeError as error:
            class_names = ", ".join(_class_names(module)) or "none"
            raise ConfigError(
                f"planner {self.name}: {self.module} holds no {format_value(self.qualname)}; "
                f"classes there: {class_names}"
            ) from error
        if not isinstance(value, type):
            raise ConfigError(f"planner {self.name}: {self.qualname} is no class")
        return value


@dataclass(frozen=True, kw_only=True)
class PlannerSpec:
    """Class and settings of a planner, from which any process can make it."""

    reference: PlannerReference
    settings: Mapping[str, object] = field(default_factory=dict)
    """Settings that differ from their defaults, checked before."""
    max_points: int = MAX_POINTS
    """Limit of way-points of one path; longer paths are refused."""

    def make(self) -> Any:
        """Return a new planner.

        Raises:
            ConfigError, UnsupportedError: as `PlannerReference.load`.
        """
        planner_class = self.reference.load()
        settings = settings_class(planner_class)
        return planner_class() if settings is None else planner_class(settings(**self.settings))


def planner_names() -> list[str]:
    """Return the names of installed planners, those of auto first."""
    return sorted(
        _installed_planners(), key=lambda name: (name not in AUTO_PLANNERS, name.swapcase())
    )


def built_in_device_planners() -> list[str]:
    """Return the names of this package's planners on the device."""
    references = {name: find(name) for name in planner_names()}
    return [name for name, found in references.items() if found.is_built_in and found.on_device]


def _is_file_path(path: str) -> bool:
    """Return whether the part before the colon is a file."""
    return path.endswith(".py")


def find(name: str) -> PlannerReference:
    """Return the reference of a planner.

    Args:
        name: of an entry point, or FILE.py:CLASS.

    Raises:
        ConfigError: there is no planner of that name, or no such file.
    """
    path, _, qualname = name.rpartition(":")
    if _is_file_path(path):
        file = Path(path)
        data = _read_file(file, name)
        return PlannerReference(
            name=name,
            module=str(file.resolve()),
            qualname=qualname,
            sha256=hashlib.sha256(data).hexdigest(),
            text=data,
        )
    if name == AUTO:
        raise ConfigError(
            f"planner {format_value(AUTO)}: is chosen in a scenario, by the number of robots; name "
            f"{' or '.join(AUTO_PLANNERS)}"
        )
    location = _installed_planners().get(name)
    if location is None and name in AUTO_PLANNERS:
        raise ConfigError(
            f"planner {format_value(name)}: the installed angler-mjx has no such entry point; "
            "install it again (in a checkout: make venv)"
        )
    if location is None:
        raise ConfigError(
            f"unknown planner {format_value(name)}; there is {', '.join(planner_names())}, "
            "or give a class of a file as FILE.py:CLASS"
        )
    module, _, qualname = location.partition(":")
    return PlannerReference(name=name, module=module, qualname=qualname)


def settings_class(planner: type) -> type | None:
    """Return the dataclass of a planner's settings; None of a planner without.

    Raises:
        ConfigError: it is no dataclass, or a setting has no default.
    """
    settings = getattr(planner, "Settings", None)
    if settings is None:
        return None
    if not (isinstance(settings, type) and is_dataclass(settings)):
        raise ConfigError(f"planner {planner.__name__}: Settings is no dataclass")
    required = [setting.name for setting in fields(settings) if _is_required(setting)]
    if required:
        raise ConfigError(
            f"planner {planner.__name__}: Settings.{required[0]} has no default; give it one"
        )
    return settings


def plans_joints(spec: PlannerSpec) -> bool:
    """Return whether paths are `JointTrajectory`: ``joints`` of the settings or the class."""
    return _read_flag(spec, "joints") or plans_arms(spec)


def plans_arms(spec: PlannerSpec) -> bool:
    """Return whether paths move the joints of arms too: ``arm`` of the settings or the class."""
    return _read_flag(spec, "arm")


def _read_flag(spec: PlannerSpec, name: str) -> bool:
    """Return an attribute of the settings of a planner, else of its class; False without it."""
    planner_class = spec.reference.load()
    settings = settings_class(planner_class)
    default = getattr(planner_class, name, False)
    if settings is None:
        return bool(default)
    return bool(getattr(settings(**spec.settings), name, default))


def _is_required(setting: "Field[object]") -> bool:
    return setting.default is MISSING and setting.default_factory is MISSING


def _read_file(file: Path, name: str) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"planner {format_value(name)}: {file} cannot be read ({error.strerror or error})"
        ) from error


def _installed_planners() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=GROUP)}


def _import_module(reference: PlannerReference) -> ModuleType:
    try:
        return importlib.import_module(reference.module)
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            f"planner {reference.name}: needs {error.name}, which is not installed; "
            "the planners that come with this package: pip install 'angler-mjx[plan]'"
        ) from error


def _class_names(module: ModuleType) -> Iterator[str]:
    for name, value in vars(module).items():
        if inspect.isclass(value) and value.__module__ == module.__name__:
            yield name
