"""Folder of a run at its start: a new one, or an interrupted one that is resumed."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable
from angler_mjx.progress import Progress
from angler_mjx.robot.vehicles import library
from angler_mjx.runs import sizes
from angler_mjx.runs.provenance import describe_environment, write_policy
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import folder, results_folder
from angler_mjx.runs.storage.atomic_files import wrap_write_errors, write_json
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.plans.read import PlanFile, open_plans
from angler_mjx.runs.storage.read_errors import read_table
from angler_mjx.runs.storage.recorder import Recorder
from angler_mjx.scenario.scenario import Scenario

PLANS_FILE = "plans.json"
"""Says which plans are flown."""


def create_run_folder(
    simulator: Simulator, path: Path, plans: PlanFile | None = None
) -> OutputLock:
    """Make the folder of a new run, with what is known before the first world.

    Args:
        simulator: of the run.
        path: the folder to be.
        plans: that are flown, instead of the scenario's planner.
    """
    scenario, shape = simulator.scenario, sizes.trajectory_shape(simulator)
    resolved_scenario = scenario.model_copy(update=resolved_settings(simulator))
    if scenario.time.record_hz > 0:
        folder.require_space(path, scenario.worlds * shape.disk_bytes_per_world())
    lock = folder.create_folder(path)
    with lock.filling() as building:
        extra_files = [("planner", file)] if (file := planner_file(simulator)) else []
        folder.write_start_files(building, resolved_scenario, describe_environment(), extra_files)
        if plans is not None:
            write_json(building / PLANS_FILE, _describe_plans(plans))
        write_policy(building, simulator.policy)
        if scenario.time.record_hz > 0:
            _create_trajectories(simulator, building / folder.TRAJECTORIES)
    return lock


def planner_file(simulator: Simulator) -> Path | None:
    """Return the file of a user's planner class; None for other planners."""
    spec = simulator.planner
    return None if spec is None else spec.reference.file


def reopen_plans(
    building: Path, plans_path: Path | str | None, scenario: Scenario
) -> PlanFile | None:
    """Return the plans with which a run began; None where a planner made them.

    Args:
        building: folder of the run.
        plans_path: where they lie now; where they lay if left out.
        scenario: of the run.

    Raises:
        ConfigError: they are not there any more, or others.
    """
    record_path = building / PLANS_FILE
    if not record_path.exists():
        if plans_path is not None:
            raise ConfigError(
                f"--plans {plans_path}: the run was begun with a planner, without plans"
            )
        return None
    table = read_table(record_path)
    plans = open_plans(Path(plans_path or str(table.get("path"))), scenario)
    if plans.sha256() != table.get("sha256"):
        raise ConfigError(
            f"{plans.path}: is not the file of plans with which the run began; put that one back, "
            "or name it with --plans"
        )
    return plans


def _describe_plans(plans: PlanFile) -> dict[str, object]:
    """Return the plans' path, the SHA-256 of all their bytes, and the planner that they name."""
    return {
        "path": str(plans.path.absolute()),
        "sha256": plans.sha256(),
        "planner": dict(plans.group.attrs).get("planner"),
    }


def _create_trajectories(simulator: Simulator, path: Path) -> None:
    """Make the group of trajectories, with nothing in it yet."""
    Recorder.create(
        path,
        sizes.trajectory_shape(simulator),
        simulator.world_shape().environment,
        tile=simulator.tile,
        sample_dt_s=1.0 / simulator.scenario.time.record_hz,
    )


def require_same_scenario(path: Path, scenario: Scenario) -> None:
    """Refuse to go on with a run of another scenario than the one that was named.

    What a run may override stands in its folder, and is not compared.
    """
    existing = results_folder.locate_folder(path)
    if not (existing / folder.CONFIG).is_file():
        return  # and `folder.reopen_folder` says that there is no run
    stored = folder.read_scenario(existing)
    if stored.name != scenario.name:
        raise ConfigError(
            f"--resume {path}: is a run of {stored.name!r}, not of {scenario.name!r}; name "
            "that scenario, or the folder of another run with --out"
        )
    now, before = (_fixed_settings(source) for source in (scenario, stored))
    differing = [key for key in now if now[key] != before[key]]
    if differing:
        raise ConfigError(
            f"--resume {path}: the scenario {scenario.name!r} was edited since the run began "
            f"({', '.join(differing)}): undo that, or begin a new run"
        )


_FLAG_KEYS = (
    ("time", "record_hz"),
    ("planner", "name"),
    ("planner", "requested"),
    ("planner", "replan_hz"),
    ("planner", "information"),
    ("execution", "order"),
    ("execution", "requested"),
    ("policy", "name"),
    ("policy", "information"),
)
"""Keys of tables that flags of a run change."""


def _fixed_settings(scenario: Scenario) -> dict[str, object]:
    """Return the settings that no flag of a run changes; vehicles by name."""
    table = scenario.model_dump(
        exclude={"worlds", "seed", "engine", "kernels", "tile", "description"}
    )
    for name, key in _FLAG_KEYS:
        table[name].pop(key)
    for entry in table["fleet"]:
        entry["vehicle"] = library.load_vehicle(entry["vehicle"]).name
    return table


def repair_trajectories(simulator: Simulator, building: Path, progress: Progress) -> None:
    """Put back descriptions of arrays that are missing; their tiles are then found wanting."""
    fresh = building / ".described"
    shutil.rmtree(fresh, ignore_errors=True)
    path = building / folder.TRAJECTORIES
    try:
        with wrap_write_errors(building):
            _create_trajectories(simulator, fresh)
            for name in _repair_metadata(path, fresh):
                progress.report(f"{path / name}: was missing or damaged, made again")
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _repair_metadata(path: Path, fresh: Path) -> list[str]:
    """Put back what describes a group's arrays, where it is missing or cannot be read.

    Args:
        path: group of an interrupted run.
        fresh: the same group as `Recorder.create` makes it; moved into the other piece by piece.

    Returns:
        The files that were put back, below ``path``.

    Raises:
        ConfigError: a description can be read and is of another array.
        OSError: the disk gave out.
    """
    repaired = []
    for fresh_file in sorted(file for file in fresh.rglob("*") if file.is_file()):
        name = fresh_file.relative_to(fresh)
        target = path / name
        if name.name == "zarr.json" and (stored := _read_essentials(target)) is not None:
            if stored != _read_essentials(fresh_file):
                raise ConfigError(
                    f"{target}: does not describe what this run stores; put the right file back, "
                    f"or remove {target.parent}, and it is computed again"
                )
        elif not (target.is_file() and target.read_bytes() == fresh_file.read_bytes()):
            target.parent.mkdir(parents=True, exist_ok=True)
            fresh_file.replace(target)
            repaired.append(str(name))
    return repaired


def _read_essentials(path: Path) -> JsonTable | None:
    """Return the part of a description that fixes the array's bytes; None if unreadable."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(table, dict):
        return None
    ignored = ("attributes", "dimension_names", "consolidated_metadata")
    return {key: value for key, value in table.items() if key not in ignored}


@contextmanager
def hold_lock(lock: OutputLock, *, is_new: bool) -> Iterator[None]:
    """Part from a folder at the end; take it away if it is new and nothing was computed into it."""
    try:
        yield
    except BaseException:
        if is_new and lock.handle is not None and not folder.holds_results(lock.building):
            lock.withdraw()
        raise
    finally:
        lock.release()


def resolved_settings(simulator: Simulator) -> dict[str, object]:
    """Return the settings that the simulator chose for keys missing in the scenario."""
    return {"tile": simulator.tile, "kernels": simulator.kernels}
