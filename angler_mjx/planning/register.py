"""Planners by their names: of this package, of other packages, of files.

    auto                            grid or priority, resolved by the scenario
    grid, priority, current         part of the program that draws the worlds
    RRTConnect                      an entry point of that name, in the group `GROUP`
    planners/straight.py:Straight   a class of a file

A class is only loaded where it is asked for, so that a planner whose libraries are missing harms
nobody who does not use it.
"""

import hashlib
import importlib
import inspect
import sys
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from angler_mjx.errors import ConfigError, UnsupportedError, describe_error, format_value
from angler_mjx.planning.planner import MAX_POINTS
from angler_mjx.planning.planner_choice import AUTO, AUTO_PLANNERS

GROUP = "angler_mjx.planners"
"""Of entry points by which other packages bring planners: NAME = "module:Class"."""

DEVICE: Mapping[str, str] = {
    "grid": "angler_mjx.planning.grid:GridPlanner",
    "priority": "angler_mjx.planning.priority.planner:PriorityPlanner",
    "current": "angler_mjx.planning.current.planner:CurrentPlanner",
}
"""Planners that are part of the program which draws the worlds, and their classes."""


@dataclass(frozen=True, kw_only=True)
class PlannerReference:
    """Where the class of a planner is; can be given to another process."""

    name: str
    """As the scenario names it."""
    module: str
    """Name of a module, or path of a file."""
    qualname: str
    """Of the class in it."""
    sha256: str | None = None
    """Of the file."""
    text: bytes | None = field(default=None, repr=False, compare=False)
    """Of the file when the planner was chosen; every process runs this text, whatever the file
    holds later."""

    @property
    def on_device(self) -> bool:
        """Whether it is part of the program that draws the worlds, without a problem between."""
        return self.name in DEVICE

    @property
    def file(self) -> Path | None:
        """The file, where it is one."""
        return Path(self.module) if self.sha256 is not None else None

    def load(self) -> type:
        """The class.

        Raises:
            ConfigError: there is no such class, or the file cannot be run.
            UnsupportedError: it needs a library that is not installed.
        """
        module = _load_file_module(self) if self.file else _import_module(self)
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
    """A planner that can be made anywhere: its class and its settings."""

    reference: PlannerReference
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Those that differ from their defaults; checked before."""
    max_points: int = MAX_POINTS
    """Of one path that can be flown; who gives more is refused."""

    def make(self) -> Any:
        """The planner.

        Raises:
            ConfigError, UnsupportedError: as `PlannerReference.load`.
        """
        planner_class = self.reference.load()
        settings = settings_class(planner_class)
        return planner_class() if settings is None else planner_class(settings(**self.settings))


def planner_names() -> list[str]:
    """Return the planners that can be named anywhere, the built-in ones first; auto is none."""
    return [*DEVICE, *sorted(_installed_planners())]


def resolve_planner_name(name: str, folder: Path) -> str:
    """The same name; a class of a file with the file's path from a folder, made absolute."""
    path, _, qualname = name.rpartition(":")
    return f"{(folder / path).absolute()}:{qualname}" if _is_file_path(path) else name


def _is_file_path(path: str) -> bool:
    """Whether what stands before a colon is the file of a class."""
    return path.endswith(".py")


def find(name: str) -> PlannerReference:
    """Where a planner is.

    Args:
        name: of one, or FILE.py:CLASS.

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
    location = DEVICE.get(name) or _installed_planners().get(name)
    if location is None:
        raise ConfigError(
            f"unknown planner {format_value(name)}; there is {', '.join(planner_names())}, "
            "or give a class of a file as FILE.py:CLASS"
        )
    module, _, qualname = location.partition(":")
    return PlannerReference(name=name, module=module, qualname=qualname)


def settings_class(planner: type) -> type | None:
    """The dataclass of a planner's settings; None where it has none."""
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
    """Whether a planner's paths are trajectories of joints: ``joints`` of its settings or class."""
    planner_class = spec.reference.load()
    settings = settings_class(planner_class)
    default = getattr(planner_class, "joints", False)
    if settings is None:
        return bool(default)
    return bool(getattr(settings(**spec.settings), "joints", default))


def _is_required(setting: "Field[Any]") -> bool:
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


def _import_module(reference: PlannerReference) -> Any:
    try:
        return importlib.import_module(reference.module)
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            f"planner {reference.name}: needs {error.name}, which is not installed; "
            "the planners that come with this package: pip install 'angler-mjx[plan]'"
        ) from error


def _load_file_module(reference: PlannerReference) -> Any:
    """Run the text of a file as a module, once in each process; it can import files beside it.

    Another text is another module. The text is that of the time when the planner was chosen, so a
    process that starts after an edit, or on a machine without the file, plans as all others do.
    """
    path, text = Path(reference.module), reference.text or b""
    name = f"angler_mjx_planner_{path.stem}_{str(reference.sha256)[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except Exception as error:  # a user's code may raise any exception; the message names it
        del sys.modules[name]
        raise ConfigError(f"{path}: cannot be run ({describe_error(error, path)})") from error
    return module


def _class_names(module: Any) -> Iterator[str]:
    for name, value in vars(module).items():
        if inspect.isclass(value) and value.__module__ == module.__name__:
            yield name
