"""Import paths of versions before 0.2: each loads the new module, with a DeprecationWarning."""

import importlib
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType

MOVED = {
    "angler_mjx.acoustics": "angler_mjx.world.acoustics",
    "angler_mjx.benchmark": "angler_mjx.studies.benchmark",
    "angler_mjx.control": "angler_mjx.robot.control",
    "angler_mjx.datasets": "angler_mjx.learning.datasets",
    "angler_mjx.datasets.reading": "angler_mjx.learning.datasets",
    "angler_mjx.engines": "angler_mjx.sim.engines",
    "angler_mjx.flights": "angler_mjx.studies.flights",
    "angler_mjx.interop": "angler_mjx.report.interop",
    "angler_mjx.physics": "angler_mjx.sim.physics",
    "angler_mjx.learning.datasets.reading": "angler_mjx.learning.datasets",
    "angler_mjx.planning.host.ray_workers": "angler_mjx.planning.host.cluster.ray_workers",
    "angler_mjx.planning.routes.fields": "angler_mjx.planning.routes.route_fields",
    "angler_mjx.robot.control.joint_goal": "angler_mjx.robot.control.commands.joint_goal",
    "angler_mjx.robot.control.joint_tolerance": "angler_mjx.robot.control.commands.joint_tolerance",
    "angler_mjx.robot.control.joint_trajectory": (
        "angler_mjx.robot.control.commands.joint_trajectory"
    ),
    "angler_mjx.robot.control.laws.targets": "angler_mjx.robot.control.commands",
    "angler_mjx.robot.control.trajectory": "angler_mjx.robot.control.commands.trajectory",
    "angler_mjx.planning.grid": "angler_mjx.planning.path_search.grid",
    "angler_mjx.report.viewing.outlines": "angler_mjx.report.plotting.outlines",
    "angler_mjx.report.viewing.scene": "angler_mjx.report.plotting.scene",
    "angler_mjx.report.viewing.style": "angler_mjx.report.plotting.style",
    "angler_mjx.scenario.reference": "angler_mjx.cli.reference",
    "angler_mjx.studies.cells": "angler_mjx.studies.sweep",
    "angler_mjx.runs.progress": "angler_mjx.progress",
    "angler_mjx.runs.session.batch": "angler_mjx.runs.session.batch_session",
    "angler_mjx.runs.session.flying": "angler_mjx.runs.session.session_flight",
    "angler_mjx.runs.session.online": "angler_mjx.runs.session.online_policy",
    "angler_mjx.runs.storage.inputs": "angler_mjx.runs.storage.input_copies",
    "angler_mjx.runs.storage.intervals": "angler_mjx.runs.storage.confidence_intervals",
    "angler_mjx.sensing": "angler_mjx.robot.sensing",
    "angler_mjx.session": "angler_mjx.runs.session",
    "angler_mjx.session.batch": "angler_mjx.runs.session.batch_session",
    "angler_mjx.session.flying": "angler_mjx.runs.session.session_flight",
    "angler_mjx.session.online": "angler_mjx.runs.session.online_policy",
    "angler_mjx.sim.knowledge": "angler_mjx.sim.information",
    "angler_mjx.simulator": "angler_mjx.runs.simulator",
    "angler_mjx.speed": "angler_mjx.studies.speed",
    "angler_mjx.speed.measuring": "angler_mjx.studies.speed.measured.measuring",
    "angler_mjx.storage": "angler_mjx.runs.storage",
    "angler_mjx.storage.inputs": "angler_mjx.runs.storage.input_copies",
    "angler_mjx.storage.intervals": "angler_mjx.runs.storage.confidence_intervals",
    "angler_mjx.studies.speed.measuring": "angler_mjx.studies.speed.measured.measuring",
    "angler_mjx.tasks": "angler_mjx.world.tasks",
    "angler_mjx.trials": "angler_mjx.studies.trials",
    "angler_mjx.tuning": "angler_mjx.studies.tuning",
    "angler_mjx.validation": "angler_mjx.testing.validation",
    "angler_mjx.vehicles": "angler_mjx.robot.vehicles",
    "angler_mjx.viewing": "angler_mjx.report.viewing",
    "angler_mjx.world.grid": "angler_mjx.world.rock.grid",
    "angler_mjx.world.rules": "angler_mjx.world.rock.rules",
    "angler_mjx.viewing.outlines": "angler_mjx.report.plotting.outlines",
    "angler_mjx.viewing.scene": "angler_mjx.report.plotting.scene",
    "angler_mjx.viewing.style": "angler_mjx.report.plotting.style",
}
"""New package or module by its old path; modules below have the same names."""

RENAMED = {
    "angler_mjx.progress": {"SilentProgress": "Progress"},
    "angler_mjx.learning.environment": {"make": "make_env"},
    "angler_mjx.planning.host.robots": {"Robot": "PlannedRobot"},
    "angler_mjx.planning.routes.route_fields": {"draw": "compute_routes"},
    "angler_mjx.robot.control.mixed": {"Mixed": "MixedCommand"},
    "angler_mjx.runs.session.online_policy": {
        "Flyer": "OnlineFlyer",
        "problem_of": "build_session_problem",
    },
    "angler_mjx.runs.session.session_flight": {"fly": "fly_session"},
    "angler_mjx.runs.storage.input_copies": {"copies": "vehicle_copies"},
    "angler_mjx.sim.information": {
        "KnownCurrent": "CurrentInformation",
        "KnownObstacles": "ObstacleInformation",
        "Knows": "Information",
        "Level": "InformationLevel",
    },
    "angler_mjx.sim.policy": {"Known": "PolicyInput"},
    "angler_mjx.world.routes": {"distance": "distance_to_goal"},
    "angler_mjx.world.tasks.allocation": {"View": "AllocationView"},
}
"""New public names by module and old name."""


def moved(name: str) -> str | None:
    """Return the new path of a module; None if it has not moved."""
    before = name
    while before not in MOVED:
        before = before.rpartition(".")[0]
        if not before:
            return None
    return MOVED[before] + name.removeprefix(before)


def renamed(module: str, name: str) -> object:
    """Return an attribute of a module by its old name, with a DeprecationWarning.

    Args:
        module: new module; calls this from its ``__getattr__``.
        name: old name, which the module does not have.

    Raises:
        AttributeError: the name is no old name either.
    """
    today = RENAMED[module].get(name)
    if today is None:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(
        f"{module}.{name} is {today} since 0.2; the old name works until 1.0",
        DeprecationWarning,
        stacklevel=3,
    )
    return getattr(sys.modules[module], today)


def renamed_attribute(instance: object, name: str, names: Mapping[str, str]) -> object:
    """Return an attribute of an object by its old name, with a DeprecationWarning.

    Args:
        instance: object without the name; its ``__getattr__`` calls this.
        name: of the attribute.
        names: new names by old names.

    Raises:
        AttributeError: the name is no old name either.
    """
    kind, today = type(instance).__name__, names.get(name)
    if today is None:
        raise AttributeError(f"{kind!r} object has no attribute {name!r}")
    warnings.warn(
        f"{kind}.{name} is {today} since 0.2; the old name works until 1.0",
        DeprecationWarning,
        stacklevel=3,
    )
    return getattr(instance, today)


class _Finder(MetaPathFinder, Loader):
    """A finder of modules at their old paths."""

    def __init__(self) -> None:
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return None if moved(name) is None else spec_from_loader(name, self)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        today = moved(spec.name) or spec.name
        warnings.warn(
            f"{spec.name} is {today} since 0.2; the old path works until 1.0",
            DeprecationWarning,
            stacklevel=2,  # frames of the import system do not count
        )
        module = importlib.import_module(today)
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own spec: the import system has put the old path's spec there."""
        spec = module.__spec__
        if spec is not None and spec.name in self._specs:
            module.__spec__ = self._specs.pop(spec.name)


def install() -> None:
    """Make the import system find modules at their old paths."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        # Before the path finder, which would load a second copy of a module in a moved package.
        sys.meta_path.insert(0, _Finder())
