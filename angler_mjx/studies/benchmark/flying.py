"""Flying the plans of a setting: all of them in one rollout, and what became of each."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from angler_mjx.planning.answers import Answer
from angler_mjx.planning.planner import NoPlan, Path
from angler_mjx.progress import Progress
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs import device_batches
from angler_mjx.runs.simulator import host_planning
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import device_to_host, results
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.sim.state import World
from angler_mjx.studies.benchmark import path_archive as bytes_of
from angler_mjx.studies.benchmark.measures import measure_flight
from angler_mjx.studies.benchmark.problem_settings import Setting
from angler_mjx.studies.benchmark.store import BenchmarkStore

TRACK_SAMPLES = 240
"""Most places of a track that is drawn."""


@dataclass(frozen=True, kw_only=True)
class BenchmarkFlight:
    """The plans of one planner for the worlds of a setting."""

    planner: int
    """Its number in the database."""
    runs: Mapping[int, int]
    """Numbers of the runs by world."""
    plans: Mapping[int, list[Path | None]]
    """Paths of each robot by world; None where there is none. Empty where a policy flies."""


def find_unflown_plans(
    experiment: int, planners: Sequence[int], store: BenchmarkStore
) -> list[BenchmarkFlight]:
    """Plans of a setting that were not flown yet.

    Raises:
        ConfigError: the database is damaged.
    """
    flights = []
    for planner in planners:
        rows = store.rows(
            "SELECT runs.id, world, paths FROM runs LEFT JOIN plans ON plans.runid = runs.id "
            "WHERE experimentid = ? AND plannerid = ? AND flown IS NULL ORDER BY world",
            (experiment, planner),
        )
        if rows:
            with wrap_read_errors(store.path):
                plans = {
                    row["world"]: []
                    if row["paths"] is None
                    else bytes_of.unpack_paths(row["paths"])
                    for row in rows
                }
            runs = {row["world"]: row["id"] for row in rows}
            flights.append(BenchmarkFlight(planner=planner, runs=runs, plans=plans))
    return flights


def fly_plans(
    setting: Setting,
    simulator: Simulator,
    flights: Sequence[BenchmarkFlight],
    examples: int,
    store: BenchmarkStore,
) -> None:
    """Fly plans, and keep what became of them; of each tile at once, or not at all.

    Args:
        setting: whose worlds.
        simulator: of its scenario.
        flights: of it.
        examples: how many first worlds' tracks are kept.
        store: where to keep it.
    """
    tile = simulator.tile
    flight_tiles = [
        (flight, first)
        for flight in flights
        for first in range(0, setting.scenario.worlds, tile)
        if any(first <= world < first + tile for world in flight.plans)
    ]
    pending_tiles = iter(flight_tiles)
    batches = device_batches.simulate_tiles(
        simulator,
        [first for _, first in flight_tiles],
        recorded=setting.scenario.time.record_hz > 0,
        progress=Progress(),
        plans=_TilePlans(flight_tiles),
        seed=setting.seed,
        strict=False,
    )
    for batch in batches:
        for finished in batch:
            flight, _ = next(pending_tiles)
            _store_flights(flight, finished, simulator, setting, examples, store)


class _TilePlans:
    """Plans for tiles of worlds: which planner's, and which worlds, as they come."""

    def __init__(self, flight_tiles: Sequence[tuple[BenchmarkFlight, int]]) -> None:
        self._coming = iter(flight_tiles)

    def of(self, firsts: list[int], worlds: World, simulator: Simulator) -> tuple[Plan, None]:
        """See `device_batches.StoredPlans`; worlds without a plan hold their starts."""
        answers: dict[int, Answer] = {}
        for t in range(len(firsts)):
            flight, first = next(self._coming)
            for world, paths in flight.plans.items():
                if paths and first <= world < first + simulator.tile:
                    answers[t * simulator.tile + world - first] = _build_answer(paths)
        held = jax.device_get(worlds.path)
        return host_planning.gather_paths(answers, held)[0], None


def _build_answer(paths: Sequence[Path | None]) -> Answer:
    robot_paths = [NoPlan("no plan") if path is None else path for path in paths]
    return Answer(paths=robot_paths, status="planned", reason="", planning_s=0.0)


def _store_flights(
    flight: BenchmarkFlight,
    tile: FinishedTile,
    simulator: Simulator,
    setting: Setting,
    examples: int,
    store: BenchmarkStore,
) -> None:
    table = results.episode_table(
        device_to_host.build_tile_result(tile), simulator.labels(), setting.seed
    )
    rows_by_world = defaultdict(list)
    for row in table.to_pylist():
        rows_by_world[row["world"]].append(row)
    hz = setting.scenario.time.record_hz
    runs = {world: run for world, run in flight.runs.items() if world in rows_by_world}
    store.add_flights(
        [
            (
                run,
                measure_flight(
                    rows_by_world[world], all(path is not None for path in flight.plans[world])
                ),
                rows_by_world[world],
            )
            for world, run in runs.items()
        ],
        {
            run: bytes_of.pack_arrays(p_m=_sample_track(tile, world - tile.first, hz))
            for world, run in runs.items()
            if world < examples and tile.parts
        },
    )


def _sample_track(tile: FinishedTile, world: int, record_hz: float) -> np.ndarray:
    """[T, R, 3] where the robots of a world were, until the last of them had ended, m, W."""
    end = float(np.max(np.asarray(tile.end.tally.end_time_s)[world]))
    p = np.concatenate([np.asarray(part.p)[world] for part in tile.parts])
    whole = p[: 1 + int(end * record_hz)]
    return whole[:: -(-len(whole) // TRACK_SAMPLES) or 1]
