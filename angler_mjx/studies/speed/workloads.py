"""The workloads of `angler bench` as data, and the rows that a request asks for."""

import math
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.stages import CONTROLLERS
from angler_mjx.runs.simulator import devices
from angler_mjx.runs.simulator.simulator import default_tile
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.scenario import Kernels, Scenario, load_scenario, shipped_scenarios
from angler_mjx.studies.speed.rows import check_repeats

type Kind = Literal[
    "dynamics",
    "arm_dynamics",
    "simulation",
    "recording",
    "preparation",
    "generation",
    "clearance",
    "search",
    "compilation",
]
type Engine = Literal["mjx", "fused"]
type Profile = Literal["quick", "full", "paper"]


@dataclass(frozen=True, kw_only=True)
class Workload:
    """Something to measure."""

    about: str
    kind: Kind
    source: str = ""
    """Scenario, by name or path, or preset."""
    engine: Engine | None = None
    """Where none is asked for."""
    robots: int
    """In each world where no number is asked for; 0 for the scenario's own."""
    label: str
    """Name in the rows; ``{robots}`` stands for their number."""
    record_hz: float | None = None
    """The scenario's own where None."""
    policy: str | None = None
    """The scenario's own where None, as the next."""
    planner: str | None = None
    worlds: int | None = None
    """In one device call where no number is asked for; None for those of the profile."""


WORKLOADS: dict[str, Workload] = {
    "dynamics": Workload(
        about="the equations of motion alone, one BlueROV2 Heavy in each world, whatever is asked",
        kind="dynamics",
        engine="fused",
        robots=1,
        label="dynamics",
    ),
    "dynamics_arm": Workload(
        about="the same of one BlueROV2 Heavy with a Reach Alpha 5, its joints on the way",
        kind="arm_dynamics",
        engine="mjx",
        robots=1,
        label="dynamics_arm",
    ),
    "closed_loop_8": Workload(
        about="eight BlueROV2 Heavy, one parameter set, four vortices, 24 cells of rock",
        kind="simulation",
        source="closed_loop_8",
        engine="fused",
        robots=8,
        label="closed_loop_{robots}",
    ),
    "reef_fleet": Workload(
        about="the demo: two kinds, drawn parameters, twelve drifting obstacles",
        kind="simulation",
        source="reef_fleet",
        engine="fused",
        robots=4,
        label="reef_fleet",
    ),
    "mjx": Workload(
        about="the demo on MuJoCo MJX",
        kind="simulation",
        source="reef_fleet",
        engine="mjx",
        robots=4,
        label="reef_fleet",
    ),
    "recording": Workload(
        about="the demo's trajectories at 10 Hz, written to the disk that holds the rows",
        kind="recording",
        source="reef_fleet",
        engine="fused",
        robots=4,
        label="recording/reef_fleet",
        record_hz=10.0,
    ),
    "preparation": Workload(
        about="drawing and planning the worlds of the demo",
        kind="preparation",
        source="reef_fleet",
        robots=4,
        label="preparation/reef_fleet",
    ),
    "env_generation": Workload(
        about="drawing worlds of the paper, 12^3 cells, with starts and goals",
        kind="generation",
        source="angler2024",
        robots=4,
        label="env_generation",
    ),
    "clearance": Workload(
        about="exact distances of hulls to cells",
        kind="clearance",
        robots=8,
        label="clearance",
    ),
    "search": Workload(
        about="one processor core in graph search, which scales the time limits of ANGLER-1",
        kind="search",
        robots=1,
        label="search",
        worlds=1,
    ),
    "compile": Workload(
        about="seconds that the programs of the shipped scenarios take to compile",
        kind="compilation",
        robots=0,
        label="compile",
    ),
}


def _compiled(label: str, source: str = "reef_fleet", **changes: Any) -> Workload:
    """Build a setting whose programs the workload ``compile`` compiles."""
    return replace(WORKLOADS["compile"], label=f"compile/{label}", source=source, **changes)


COMPILED_SETTINGS = (
    _compiled("reef_fleet_fused", engine="fused", robots=4, worlds=128),
    _compiled("reef_fleet_mjx", engine="mjx", robots=4, worlds=128),
    _compiled("reef_fleet_fused_many", engine="fused", robots=4, worlds=16384),
    _compiled("reef_fleet_mjx_many", engine="mjx", robots=4, worlds=16384),
    _compiled("million", engine="fused", robots=4, worlds=65536),
    _compiled("team_of_12", engine="fused", robots=12, worlds=32, planner="priority"),
    _compiled("team_of_64", engine="fused", robots=64, worlds=256, planner="priority"),
    _compiled("mppi", "dense_dynamic", engine="fused", robots=4, worlds=512, policy="mppi"),
)
"""Settings of the workload ``compile`` for the profiles full and paper."""


@dataclass(frozen=True, kw_only=True)
class WorkloadGrid:
    """Sizes of a profile; an empty tuple stands for a workload's own number of robots."""

    workloads: tuple[str, ...]
    worlds: tuple[int, ...]
    robots: tuple[int, ...] = ()


_ALL = tuple(name for name in WORKLOADS if name not in ("recording", "search", "compile"))
"""But the disk's, which takes as much of the disk as a run, a processor core's and the compiler's:
none is the speed of the device."""

PROFILES: dict[Profile, WorkloadGrid] = {
    "quick": WorkloadGrid(
        workloads=("dynamics", "closed_loop_8", "reef_fleet", "mjx", "clearance"), worlds=(64,)
    ),
    "full": WorkloadGrid(workloads=_ALL, worlds=(1, 64, 1024, 16384)),
    "paper": WorkloadGrid(
        workloads=_ALL,
        worlds=(1, 64, 1024, 16384, 262144),
        robots=(1, 4, 16, 64),
    ),
}


@dataclass(frozen=True, kw_only=True)
class SpeedRequest:
    """What is asked for; empty tuples stand for the profile's."""

    profile: Profile = "quick"
    workloads: tuple[str, ...] = ()
    scenarios: tuple[str, ...] = ()
    """Compiled by the workload ``compile``, by name or path; all shipped ones if empty."""
    worlds: tuple[int, ...] = ()
    robots: tuple[int, ...] = ()
    engine: Engine | None = None
    kernels: Kernels | None = None
    controllers: tuple[str, ...] = ()
    """Of simulations; a scenario's own if empty."""
    repeats: int = 10
    devices: int = 1
    """Of simulations; other workloads use one."""
    folder: Path = Path()
    """On the disk that `recording` measures."""


@dataclass(frozen=True, kw_only=True)
class WorkloadCase:
    """One row to be measured."""

    workload: Workload
    worlds: int
    robots: int
    scenario: Scenario | None
    """Of the workloads that have one."""
    repeats: int
    devices: int
    prepared: int
    """Different worlds that the largest row of the same fleet needs, so that all rows can share."""
    kernels: Kernels | None
    folder: Path
    controller: str | None = None
    """Where one was asked for."""

    @property
    def label(self) -> str:
        """Name in the row."""
        name = self.workload.label.format(robots=self.robots)
        return f"{name}/{self.controller}" if self.controller else name


def build_cases(request: SpeedRequest) -> list[WorkloadCase]:
    """All rows of a request; worlds grow fastest.

    Raises:
        ConfigError: an unknown workload, a number below 1, or what cannot go together.
    """
    check_repeats(request.repeats)
    grid = PROFILES[request.profile]
    devices.build_mesh(request.devices)
    for flag, numbers in (("worlds", request.worlds), ("robots", request.robots)):
        if any(n < 1 for n in numbers):
            raise ConfigError(f"--{flag} {min(numbers)}: must be at least 1")
    fleet_cases = []
    for workload in _select_workloads(request, grid):
        name = workload.label
        if workload.kind == "dynamics" and request.engine == "mjx":
            raise ConfigError(f"--engine mjx: workload {name} is for the fused engine alone")
        if workload.kind == "arm_dynamics" and request.engine == "fused":
            raise ConfigError(f"--engine fused: workload {name} is for the mjx engine alone")
        # Programs are compiled for the tile of a run, whatever worlds a profile simulates.
        is_compiled = workload.kind == "compilation"
        compiled_worlds = (workload.worlds,) if workload.worlds else ()
        sizes = request.worlds or (compiled_worlds if is_compiled else grid.worlds)
        if workload.kind == "search":
            sizes = (1,)
        for robots in _robot_counts(
            workload, request.robots or (() if is_compiled else grid.robots)
        ):
            for controller in _select_controllers(workload, request):
                fleet_cases += _build_fleet_cases(workload, robots, request, sizes, controller)
    return fleet_cases


def _select_workloads(request: SpeedRequest, grid: WorkloadGrid) -> list[Workload]:
    """Workloads of a request; of ``compile`` one for each scenario.

    Raises:
        ConfigError: an unknown workload or scenario, or scenarios that nothing compiles.
    """
    selected, is_compiled = [], False
    for workload in map(find_workload, request.workloads or grid.workloads):
        if workload.kind != "compilation":
            selected.append(workload)
            continue
        is_compiled = True
        if not request.scenarios and request.profile != "quick":
            selected += COMPILED_SETTINGS
            continue
        for name in request.scenarios or tuple(shipped_scenarios()):
            simulation = _simulation_workload(name)
            label = f"{workload.label}/{simulation.label}"
            selected.append(replace(workload, source=name, robots=simulation.robots, label=label))
    if request.scenarios and not is_compiled:
        raise ConfigError(
            f"--scenario {request.scenarios[0]}: is for --workload compile; to simulate it, give "
            f"--workload {request.scenarios[0]}"
        )
    return selected


def _robot_counts(workload: Workload, robots: tuple[int, ...]) -> tuple[int, ...]:
    """Numbers of robots in a world that a workload is measured for."""
    is_alone = workload.kind in ("dynamics", "arm_dynamics", "search")
    return (workload.robots,) if is_alone or not robots else robots


def _select_controllers(workload: Workload, request: SpeedRequest) -> tuple[str | None, ...]:
    """Controllers that a workload is measured with; None for its own."""
    if unknown := [name for name in request.controllers if name not in CONTROLLERS]:
        raise ConfigError(f"--controller {unknown[0]}: there is {', '.join(CONTROLLERS)}")
    return (workload.kind == "simulation" and request.controllers) or (None,)


def _build_fleet_cases(
    workload: Workload,
    robots: int,
    request: SpeedRequest,
    worlds: tuple[int, ...],
    controller: str | None,
) -> list[WorkloadCase]:
    """The rows of one workload, number of robots and controller."""
    scenario = _build_scenario(workload, robots, request, controller)
    if not worlds and scenario is not None:
        worlds = (scenario.tile or default_tile(scenario.worlds),)
    devices = request.devices if workload.kind == "simulation" else 1
    return [
        WorkloadCase(
            workload=workload,
            worlds=size,
            robots=robots,
            scenario=scenario,
            repeats=request.repeats,
            devices=devices,
            prepared=devices * max(worlds),
            kernels=request.kernels,
            folder=request.folder,
            controller=controller,
        )
        for size in sorted(worlds)
    ]


def find_workload(name: str) -> Workload:
    """A workload by its name, or the simulation of a scenario by its name or path.

    Raises:
        ConfigError: there is neither.
    """
    if name in WORKLOADS:
        return WORKLOADS[name]
    if name not in shipped_scenarios() and not name.endswith(".toml"):
        raise ConfigError(
            f"--workload {name}: there is {', '.join(WORKLOADS)}; also the scenarios "
            f"{', '.join(shipped_scenarios())}, and any path of a .toml file"
        )
    return _simulation_workload(name)


def _simulation_workload(name: str) -> Workload:
    """The simulation of a scenario by its name or path.

    Raises:
        ConfigError: there is no such scenario, or its file has faults.
    """
    scenario = load_scenario(name)
    return Workload(
        about=scenario.description,
        kind="simulation",
        source=name,
        robots=len(scenario.members()),
        label=scenario.name,
    )


def _build_scenario(
    workload: Workload, robots: int, request: SpeedRequest, controller: str | None
) -> Scenario | None:
    """The scenario of a workload with this many robots; None for workloads without one."""
    if workload.kind not in ("simulation", "recording", "preparation", "compilation"):
        return None
    changes: dict[str, Any] = {}
    if engine := request.engine or workload.engine:
        changes["engine"] = engine
    if request.kernels is not None and engine != "mjx":
        changes["kernels"] = request.kernels
    if workload.policy is not None:
        changes["policy"] = {"name": workload.policy}
    if workload.planner is not None:
        changes["planner"] = {"name": workload.planner}
    if controller is not None:
        changes["controller"] = {"name": controller}
    if workload.record_hz is not None:
        changes["time"] = {"record_hz": workload.record_hz}
    name = workload.source
    if name in shipped_scenarios() or name.endswith(".toml"):
        return _load_resized(name, robots, changes)
    file = resources.files("angler_mjx.studies.speed") / "data" / f"{name}.toml"
    with resources.as_file(file) as path:
        return _load_resized(path, robots, changes)


def _load_resized(name: str | Path, robots: int, changes: dict[str, Any]) -> Scenario:
    scenario = load_scenario(name, **changes)
    if len(scenario.members()) == robots:
        return scenario
    # Teams of all sizes are measured with one planner, or rates would compare two.
    planner = {"name": scenario.planner.name}
    fleet = _scale_fleet(scenario.fleet, robots)
    return load_scenario(name, **{**changes, "fleet": fleet, "planner": planner})


def _scale_fleet(entries: tuple[FleetEntry, ...], robots: int) -> list[dict[str, Any]]:
    """The entries of a fleet with ``robots`` in all, in about the same proportions."""
    before = sum(entry.count for entry in entries)
    # Whole numbers by cumulative rounding: they add up, and the first entry is served first.
    ends, assigned, fleet = 0, 0, []
    for entry in entries:
        ends += entry.count
        count = math.ceil(robots * ends / before) - assigned
        assigned += count
        if count > 0:
            fleet.append({**entry.model_dump(exclude_unset=True), "count": count})
    return fleet
