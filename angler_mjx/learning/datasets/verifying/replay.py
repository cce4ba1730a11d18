"""Comparison of a dataset's episodes with flights repeated from its own description."""

import gc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jax
import numpy as np

from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.learning.datasets.verifying.report import DatasetCheck
from angler_mjx.planning.planner import PathShape
from angler_mjx.progress import Progress
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs import device_batches, sizes
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.simulator.host_planning import PlanNotes
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import device_to_host, trajectory_layout
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.quantization import Quantization
from angler_mjx.sim.state import Outcome, World

COMPARED_KEYS = ("backend", "device")
"""Keys of an environment that bytes depend on, beside versions and the tile."""
COMPARED_VERSIONS = ("angler-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx")

COMPARE_AT_S, MAX_APART_M, MIN_NEAR_FRACTION = 10.0, 0.1, 0.95
"""On other devices and versions this fraction of the robots must be within a distance [m] after a
time [s]."""
MIN_ALIKE_FRACTION = 0.9
"""Least fraction of robots with the same outcome."""


@dataclass(kw_only=True)
class _ReplayComparison:
    """Comparison of repeated flights."""

    at: int
    """Sample at which positions are compared."""
    robots: int = 0
    alike: int = 0
    """Number of robots with the same outcome."""
    apart_m: list[float] = field(default_factory=list)
    """Distance of robots, `COMPARE_AT_S` into their flights; NaN where a sample is missing."""
    equal: int = 0
    worlds: int = 0


def replay_episodes(root: Path, manifest: Manifest, count: int, progress: Progress) -> DatasetCheck:
    """Fly episodes again, spread over the parts, whole tiles of them.

    Where device and versions are those that made the dataset, every byte must be the same; else
    flights may deviate within bounds.

    Args:
        root: folder of the dataset.
        manifest: its manifest.
        count: number of episodes.
        progress: receives the number of episodes.
    """
    progress.start(count, unit="episodes")
    progress.describe("flying again")
    check = DatasetCheck(name="flown again")
    differing = environment_differences(manifest)
    comparison = _ReplayComparison(at=round(COMPARE_AT_S * manifest.time["record_hz"]))
    selected = select_worlds(manifest.parts, count)
    for part, worlds in selected:
        _replay_part(root, part, worlds, comparison, check, exact=not differing)
        progress.advance(len(worlds))
        jax.clear_caches()
        gc.collect()
    check.unchecked = manifest.episodes - comparison.worlds
    not_flown = f"{check.unchecked} episodes were not flown again" if check.unchecked else ""
    if not differing:
        check.exact, check.why = comparison.worlds, not_flown
        check.looked_at = (
            f"{comparison.worlds} episodes, {comparison.equal} the same to the last bit"
        )
        return check
    bounded = f"another {', '.join(differing)} makes other bytes"
    check.bounded, check.why = comparison.worlds, "; ".join(filter(None, (bounded, not_flown)))
    _check_bounds(check, comparison, differing)
    return check


def _check_bounds(
    check: DatasetCheck, comparison: _ReplayComparison, differing: Sequence[str]
) -> None:
    """Record the deviation of flights, and its excess over the bounds."""
    alike = f"{comparison.alike} of {comparison.robots} robots ended alike"
    apart = np.array(comparison.apart_m)
    apart = apart[np.isfinite(apart)]
    within = f"within {MAX_APART_M:g} m after {COMPARE_AT_S:g} s"
    near = f"{(apart <= MAX_APART_M).sum()} of {len(apart)} {within}"
    check.looked_at = (
        f"{comparison.worlds} episodes, made with another {', '.join(differing)}; {alike}, {near}"
    )
    if (apart <= MAX_APART_M).sum() < MIN_NEAR_FRACTION * len(apart):
        check.add_finding(
            "flights",
            f"{near}; {100 * MIN_NEAR_FRACTION:.0f} % are to be: verify it with the versions that "
            "made "
            "it",
        )
    if comparison.alike < MIN_ALIKE_FRACTION * comparison.robots:
        check.add_finding("flights", f"{alike}; {100 * MIN_ALIKE_FRACTION:.0f} % are to")


def environment_differences(manifest: Manifest) -> list[str]:
    """Return the differences between this machine and a dataset's that bytes depend on."""
    recorded, current = manifest.environment, describe_environment()
    differences = [name for name in COMPARED_KEYS if recorded.get(name) != current[name]]
    before = recorded.get("versions", {})
    return differences + [
        name for name in COMPARED_VERSIONS if before.get(name) != current["versions"][name]
    ]


def select_worlds(parts: Sequence[PartEntry], count: int) -> list[tuple[PartEntry, list[int]]]:
    """Return worlds of one tile of each part, in proportion to its episodes."""
    total = sum(part.worlds for part in parts)
    selected, done = [], 0.0
    for part in parts:
        before, done = done, done + count * part.worlds / total
        quota = round(done) - round(before)
        tiles = -(-part.worlds // part.tile)
        first = (part.seed % tiles) * part.tile
        worlds = range(first, min(first + part.tile, part.worlds))
        take = np.unique(np.linspace(0, len(worlds) - 1, min(quota, len(worlds))).astype(int))
        if quota:
            selected.append((part, [worlds[i] for i in take]))
    return selected


@dataclass(frozen=True)
class _StoredRunPlans:
    """Plans of a run, for planners with varying results; a `device_batches.StoredPlans`."""

    run: Run

    def of(
        self, firsts: list[int], worlds: World, simulator: Simulator
    ) -> tuple[Plan, PlanNotes | None]:
        """Return stored plans; see `device_batches.StoredPlans`."""
        robots = worlds.path.time_s.shape[1]
        planned = self.run.episodes["planned"].to_numpy(zero_copy_only=False).reshape(-1, robots)
        stored = self.run.trajectories
        last = len(planned) - 1
        rows = [min(first + i, last) for first in firsts for i in range(simulator.tile)]
        made = [trajectory_layout.read_plan(stored, row, planned[row]) for row in rows]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *made), None


def _replay_part(
    root: Path,
    part: PartEntry,
    worlds: list[int],
    comparison: _ReplayComparison,
    check: DatasetCheck,
    *,
    exact: bool,
) -> None:
    """Fly the worlds' tile again and compare them."""
    run = Run(root / part.path)
    first = worlds[0] - worlds[0] % part.tile
    stored = run.trajectories
    points = stored.get_array("plan_time_s").shape[-1]
    shape = PathShape(
        points=points,
        joints="plan_degree" in stored,
        arm=trajectory_layout.plan_joint_names(stored),
    )
    simulator = Simulator(run.scenario, devices=1, tile=part.tile)
    plans = None
    if simulator.hosted:
        simulator.close()
        simulator = Simulator(run.scenario, devices=1, tile=part.tile, paths=shape)
        plans = _StoredRunPlans(run)
    try:
        simulator.compile()
        (tile,) = next(
            iter(
                device_batches.simulate_tiles(
                    simulator, [first], recorded=True, progress=Progress(), plans=plans
                )
            )
        )
    finally:
        simulator.close()
    sized = sizes.trajectory_shape(simulator)
    made = device_to_host.recorded_arrays(tile, sized.samples)
    for world in worlds:
        row = slice(world - first, world - first + 1)
        flown = {name: _round_values(take(row), sized.stepped(name)) for name, take in made.items()}
        recorded = {name: np.asarray(stored.get_array(name)[world : world + 1]) for name in flown}
        _compare_world(comparison, check, part, world, flown, recorded, exact=exact)


def _round_values(values: np.ndarray, steps: Quantization | None) -> np.ndarray:
    """Round values as a reader of the stored files gets them."""
    return values if steps is None else steps.round_values(values)


def _compare_world(
    comparison: _ReplayComparison,
    check: DatasetCheck,
    part: PartEntry,
    world: int,
    flown: Mapping[str, np.ndarray],
    recorded: Mapping[str, np.ndarray],
    *,
    exact: bool,
) -> None:
    comparison.worlds += 1
    ended = [array["end/outcome"][0].astype(int) for array in (flown, recorded)]
    ended = [np.where(outcomes == Outcome.RUNNING, Outcome.TIMEOUT, outcomes) for outcomes in ended]
    comparison.robots += ended[0].size
    comparison.alike += int((ended[0] == ended[1]).sum())
    if not exact:
        apart = np.linalg.norm(flown["p_m"] - recorded["p_m"], axis=-1)[0]
        if comparison.at < len(apart):
            comparison.apart_m += apart[comparison.at].tolist()
        return
    for name, values in flown.items():
        if not np.array_equal(values, recorded[name], equal_nan=values.dtype.kind == "f"):
            location = f"{part.path}/trajectories.zarr/{name}"
            check.add_finding(location, _format_difference(world, values[0], recorded[name][0]))
            return
    comparison.equal += 1


def _format_difference(world: int, flown: np.ndarray, recorded: np.ndarray) -> str:
    """Describe the first element that differs."""
    unequal = ~((flown == recorded) | ((flown != flown) & (recorded != recorded)))
    index = tuple(int(i) for i in np.argwhere(unequal)[0])
    return (
        f"world {world}: {recorded[index]!r} at {list(index)}, and {flown[index]!r} when flown "
        "again "
        f"({int(unequal.sum())} of {unequal.size} values differ)"
    )
