"""Episodes flown again, from what the dataset says of them, and compared with what it holds."""

import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np

from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.learning.datasets.verifying.report import DatasetCheck
from angler_mjx.planning.planner import PathShape
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs import device_batches, sizes
from angler_mjx.runs.progress import SilentProgress
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.simulator.hosted import PlanNotes
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import device_to_host, layout
from angler_mjx.runs.storage.folder import Run
from angler_mjx.sim.state import Outcome, World

SAME = ("backend", "device")
"""Of an environment: what else the bytes depend on, beside versions and the tile."""
VERSIONS = ("angler-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx")

GROWTH_S, GROWTH_M, GROWTH_SHARE = 10.0, 0.1, 0.95
"""Elsewhere this share of the robots is to be within so many metres after so many seconds."""
ALIKE_SHARE = 0.9
"""And this share is to end alike."""


@dataclass(kw_only=True)
class _Compared:
    """What came of flights again."""

    at: int
    """Sample at which places are compared."""
    robots: int = 0
    alike: int = 0
    """That ended as they had."""
    apart_m: list[float] = field(default_factory=list)
    """Of robots, `GROWTH_S` into their flights; NaN where a sample is missing."""
    equal: int = 0
    worlds: int = 0


def fly(
    place: Path, manifest: Manifest, count: int, tell: Callable[[int, int], None]
) -> DatasetCheck:
    """Fly episodes again, spread over the parts, whole tiles of them.

    Where device and versions are those that made the dataset, every byte must be the same; else
    flights may part, and only so far.

    Args:
        place: the dataset.
        manifest: of it.
        count: of the episodes.
        tell: told how many are done, and of how many.
    """
    check = DatasetCheck(name="flown again")
    differing = unlike(manifest)
    found = _Compared(at=round(GROWTH_S * manifest.time["record_hz"]))
    chosen = choose(manifest.parts, count)
    for part, worlds in chosen:
        _part(place, part, worlds, found, check, exact=not differing)
        tell(found.worlds, count)
        jax.clear_caches()
        gc.collect()
    check.unchecked = manifest.episodes - found.worlds
    not_flown = f"{check.unchecked} episodes were not flown again" if check.unchecked else ""
    if not differing:
        check.exact, check.why = found.worlds, not_flown
        check.looked_at = f"{found.worlds} episodes, {found.equal} the same to the last bit"
        return check
    bounded = f"another {', '.join(differing)} makes other bytes"
    check.bounded, check.why = found.worlds, "; ".join(filter(None, (bounded, not_flown)))
    _hold_against_bounds(check, found, differing)
    return check


def _hold_against_bounds(check: DatasetCheck, found: _Compared, differing: Sequence[str]) -> None:
    """Note how far flights parted, and what is more than they may."""
    alike = f"{found.alike} of {found.robots} robots ended alike"
    apart = np.array(found.apart_m)
    apart = apart[np.isfinite(apart)]
    within = f"within {GROWTH_M:g} m after {GROWTH_S:g} s"
    near = f"{(apart <= GROWTH_M).sum()} of {len(apart)} {within}"
    check.looked_at = (
        f"{found.worlds} episodes, made with another {', '.join(differing)}; {alike}, {near}"
    )
    if (apart <= GROWTH_M).sum() < GROWTH_SHARE * len(apart):
        check.wrong(
            "flights",
            f"{near}; {100 * GROWTH_SHARE:.0f} % are to be: verify it with the versions that made "
            "it",
        )
    if found.alike < ALIKE_SHARE * found.robots:
        check.wrong("flights", f"{alike}; {100 * ALIKE_SHARE:.0f} % are to")


def unlike(manifest: Manifest) -> list[str]:
    """In what this machine is not the one that made a dataset, as far as bytes depend on it."""
    then, now = manifest.environment, describe_environment()
    found = [name for name in SAME if then.get(name) != now[name]]
    before = then.get("versions", {})
    return found + [name for name in VERSIONS if before.get(name) != now["versions"][name]]


def choose(parts: Sequence[PartEntry], count: int) -> list[tuple[PartEntry, list[int]]]:
    """Worlds of one tile of each part, as many of a part as are its share of the episodes."""
    total = sum(part.worlds for part in parts)
    found, done = [], 0.0
    for part in parts:
        before, done = done, done + count * part.worlds / total
        mine = round(done) - round(before)
        tiles = -(-part.worlds // part.tile)
        first = (part.seed % tiles) * part.tile
        worlds = range(first, min(first + part.tile, part.worlds))
        take = np.unique(np.linspace(0, len(worlds) - 1, min(mine, len(worlds))).astype(int))
        if mine:
            found.append((part, [worlds[i] for i in take]))
    return found


@dataclass(frozen=True)
class _Stored:
    """Plans of a run, for planners that do not plan alike twice; a `device_batches.StoredPlans`."""

    run: Run

    def of(
        self, firsts: list[int], worlds: World, simulator: Simulator
    ) -> tuple[Plan, PlanNotes | None]:
        """See `device_batches.StoredPlans`."""
        robots = worlds.path.time_s.shape[1]
        planned = self.run.episodes["planned"].to_numpy(zero_copy_only=False).reshape(-1, robots)
        stored: Any = self.run.trajectories
        last = len(planned) - 1
        rows = [min(first + i, last) for first in firsts for i in range(simulator.tile)]
        made = [layout.read_plan(stored, row, planned[row]) for row in rows]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *made), None


def _part(
    place: Path,
    part: PartEntry,
    worlds: list[int],
    found: _Compared,
    check: DatasetCheck,
    *,
    exact: bool,
) -> None:
    """Fly the worlds' tile again, and compare them."""
    run = Run(place / part.path)
    first = worlds[0] - worlds[0] % part.tile
    stored: Any = run.trajectories
    shape = PathShape(points=stored["plan_time_s"].shape[-1], joints="plan_degree" in stored)
    simulator = Simulator(run.scenario, devices=1, tile=part.tile)
    plans = None
    if simulator.hosted:
        simulator.close()
        simulator = Simulator(run.scenario, devices=1, tile=part.tile, paths=shape)
        plans = _Stored(run)
    try:
        simulator.compile()
        (tile,) = next(
            iter(
                device_batches.simulate(
                    simulator, [first], recorded=True, progress=SilentProgress(), plans=plans
                )
            )
        )
    finally:
        simulator.close()
    sized = sizes.shape_of(simulator)
    made = device_to_host.arrays(tile, sized.samples)
    for world in worlds:
        here = slice(world - first, world - first + 1)
        flown = {name: _read(take(here), sized.stepped(name)) for name, take in made.items()}
        held = {name: np.asarray(stored[name][world : world + 1]) for name in flown}
        _compare(found, check, part, world, flown, held, exact=exact)


def _read(values: np.ndarray, steps: Any) -> np.ndarray:
    """As whoever reads them from the disk would get them."""
    return values if steps is None else steps.rounded(values)


def _compare(
    found: _Compared,
    check: DatasetCheck,
    part: PartEntry,
    world: int,
    flown: Mapping[str, np.ndarray],
    held: Mapping[str, np.ndarray],
    *,
    exact: bool,
) -> None:
    found.worlds += 1
    ended = [array["end/outcome"][0].astype(int) for array in (flown, held)]
    ended = [np.where(one == Outcome.RUNNING, Outcome.TIMEOUT, one) for one in ended]
    found.robots += ended[0].size
    found.alike += int((ended[0] == ended[1]).sum())
    if not exact:
        apart = np.linalg.norm(flown["p_m"] - held["p_m"], axis=-1)[0]
        if found.at < len(apart):
            found.apart_m += apart[found.at].tolist()
        return
    for name, values in flown.items():
        if not np.array_equal(values, held[name], equal_nan=values.dtype.kind == "f"):
            place = f"{part.path}/trajectories.zarr/{name}"
            check.wrong(place, _difference(world, values[0], held[name][0]))
            return
    found.equal += 1


def _difference(world: int, flown: np.ndarray, held: np.ndarray) -> str:
    """The first element in which they differ."""
    unequal = ~((flown == held) | ((flown != flown) & (held != held)))
    at = tuple(int(i) for i in np.argwhere(unequal)[0])
    return (
        f"world {world}: {held[at]!r} at {list(at)}, and {flown[at]!r} when flown again "
        f"({int(unequal.sum())} of {unequal.size} values differ)"
    )
