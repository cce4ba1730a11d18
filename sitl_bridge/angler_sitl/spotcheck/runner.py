"""Spot check from a run folder to a report: pick, rebuild, fly, compare.

Each flight is written when it ends. An interrupted spot check is reported as far as it is done, and
resumes at the interruption.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable
from angler_mjx.progress import Progress
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import results_folder
from angler_mjx.runs.storage.folder import POLICY, Run
from angler_mjx.sim.state import World
from angler_sitl.firmware import binary as binaries
from angler_sitl.firmware import parameters as firmware
from angler_sitl.firmware.probe import identify_version
from angler_sitl.scene.scenario_options import parse_speed
from angler_sitl.spotcheck import (
    flight,
    folder,
    rebuilt_worlds,
    report_page,
    world_flyers,
    world_selection,
)
from angler_sitl.spotcheck.flight import RECORDED
from angler_sitl.spotcheck.results import FlightKey, SpotcheckResult, SpotcheckSettings
from angler_sitl.spotcheck.world_flyers import SpotcheckFlyer
from angler_sitl.spotcheck.world_selection import WorldPick


def run_spot_check(
    run_path: Path,
    settings: SpotcheckSettings,
    out: Path,
    progress: Progress,
    *,
    resume: bool = False,
) -> SpotcheckResult:
    """Run a spot check and write its folder.

    Args:
        run_path: folder of a batch run with trajectories.
        settings: of the spot check.
        out: folder to create.
        progress: receives the progress.
        resume: resume an interrupted spot check in ``out``.

    Returns:
        The result; partial after an interruption (Ctrl-C).

    Raises:
        ConfigError: no such run, a run commanded by a policy, fewer worlds than requested, no
            trajectories, a vehicle without a frame, no ArduSub, or a folder that cannot be used.
        RunError: a world cannot be rebuilt, or an autopilot ended. Finished flights stay.
    """
    result = plan_spot_check(run_path, settings)
    if resume:
        lock, table = folder.reopen_folder(out, _build_request(result))
        result = _restore_picks(result, table)
    else:
        lock = folder.create_folder(out)
    with lock.keeping() as building:
        result = _fly_and_report(result, building, progress)
    lock.publish()
    return result


def _fly_and_report(result: SpotcheckResult, building: Path, progress: Progress) -> SpotcheckResult:
    """Fly the remaining flights into a folder, and write its report."""
    folder.save_table(building, _build_table(result))
    keys = _list_flights(result)
    remaining = [key for key in keys if not folder.flight_path(building, *key).is_file()]
    progress.start(len(keys), len(keys) - len(remaining), "flights")
    complete = False
    try:
        progress.describe("drawing the worlds again")
        worlds = rebuilt_worlds.sample_worlds(
            result.run.scenario, [pick.world for pick in result.picks]
        )
        result = replace(result, likeness=_compare_worlds(result, worlds))
        worlds = {
            index: rebuilt_worlds.add_recorded_plans(result.run, index, world)
            for index, world in worlds.items()
        }
        _fly_all(result, worlds, remaining, building, progress)
        complete = True
    except KeyboardInterrupt:
        if not result.likeness:
            raise
    result = replace(result, flights=_load_flights(result, building), complete=complete)
    report_page.write_report(building, result)
    folder.save_table(building, _build_table(result))
    return result


def load_result(run_path: Path, settings: SpotcheckSettings, out: Path) -> SpotcheckResult:
    """Load an earlier spot check, complete or partial.

    Args:
        run_path: folder of its run.
        settings: of its request.
        out: its folder.

    Raises:
        ConfigError: there is none, it is damaged, or its request differs.
    """
    result = plan_spot_check(run_path, settings)
    table = folder.load_table(out)
    results_folder.require_same_keys(out / folder.TABLE, _build_request(result), table["asked"])
    result = _restore_picks(result, table)
    return replace(result, flights=_load_flights(result, out), complete=table["complete"])


def has_flown_plans(run: Run) -> bool:
    """Return whether robots of a run flew plans, as autopilots can, and had no other commands.

    The policy ``reach`` is flown too: along plans, and from there by targets of end effectors.
    """
    scenario = run.scenario
    return scenario.online or scenario.policy.name == "reach" or not (run.path / POLICY).exists()


def plan_spot_check(run_path: Path, settings: SpotcheckSettings) -> SpotcheckResult:
    """Plan a spot check, and refuse faulty requests before anything is computed.

    Raises:
        ConfigError: as in `run_spot_check`.
    """
    run = Run(run_path)
    scenario = run.scenario
    if not has_flown_plans(run):
        raise ConfigError(
            f"{run.path / POLICY}: a policy commanded the robots of this run, and autopilots fly "
            "plans, not that; give a run of plans, flown as they are or made anew in flight, or of "
            'policy.name = "reach"'
        )
    _ = run.trajectories
    fleet = len(scenario.members())
    counts = tuple(dict.fromkeys(settings.robots)) or (fleet,)
    for count in counts:
        world_flyers.select_fleet(scenario, count)
    for entry in scenario.fleet:
        for level in settings.levels:
            firmware.for_vehicle(library.load_vehicle(entry.vehicle), level, settings.source)
    if not settings.levels:
        raise ConfigError("--level: give guided, thrusters or both")
    parse_speed(settings.speed)
    picks = world_selection.pick_worlds(
        run.episodes, settings.episodes, seed=settings.seed, stratify=settings.stratify
    )
    binary = identify_version(binaries.find_binary(settings.binary))
    return SpotcheckResult(
        run=run,
        settings=settings,
        picks=picks,
        counts=counts,
        likeness={},
        autopilot=f"{binary.version}, sha256 {binary.sha256[:12]}",
        provenance=describe_environment(),
    )


def _build_request(result: SpotcheckResult) -> JsonTable:
    """Return everything that the results depend on; another ArduSub flies differently."""
    return {
        "run": str(result.run.path),
        "ardusub": result.autopilot,
        **result.settings.to_request(),
    }


def _restore_picks(result: SpotcheckResult, table: folder.SpotcheckTable) -> SpotcheckResult:
    """Restore the table of an interrupted spot check, with its picked worlds."""
    picks = tuple(WorldPick(**pick) for pick in table["picks"])
    return replace(result, picks=picks)


def _build_table(result: SpotcheckResult) -> folder.SpotcheckTable:
    return {
        "asked": _build_request(result),
        "complete": result.complete,
        "picks": [{"world": pick.world, "why": pick.why} for pick in result.picks],
        "likeness": {str(world): text for world, text in result.likeness.items()},
        "provenance": dict(result.provenance),
    }


def _list_flights(result: SpotcheckResult) -> list[FlightKey]:
    """Return all flights, those of the batch simulator first."""
    names = (*result.settings.against, *result.settings.levels)
    return [
        (pick.world, name, count)
        for name in names
        for count in result.counts
        for pick in result.picks
    ]


def _compare_worlds(result: SpotcheckResult, worlds: dict[int, World]) -> dict[int, str]:
    return {
        index: rebuilt_worlds.compare_world(result.run, index, world).describe()
        for index, world in worlds.items()
    }


def _fly_all(
    result: SpotcheckResult,
    worlds: dict[int, World],
    keys: list[FlightKey],
    out: Path,
    progress: Progress,
) -> None:
    """Fly all flights; a flyer is built once for all worlds with the same number of robots."""
    for count in result.counts:
        selected = _select_robots(result, worlds, count, progress)
        for name in (*result.settings.against, *result.settings.levels):
            pending = [key for key in keys if key[1:] == (name, count)]
            if pending:
                progress.describe(f"{name}, {count} robots: compiling")
                with _make_flyer(result, name, count) as flyer:
                    _fly_worlds(flyer, pending, selected, out, progress)


def _select_robots(
    result: SpotcheckResult, worlds: dict[int, World], count: int, progress: Progress
) -> dict[int, World]:
    """Return the worlds reduced to a number of robots."""
    scenario = result.run.scenario
    if count == len(scenario.members()):
        return worlds
    progress.describe(f"{count} robots of {len(scenario.members())}")
    template = Simulator(
        rebuilt_worlds.single_world_scenario(world_flyers.select_fleet(scenario, count))
    ).world_shape()
    return {
        index: rebuilt_worlds.select_robots(world, template, count)
        for index, world in worlds.items()
    }


def _make_flyer(result: SpotcheckResult, name: str, count: int) -> SpotcheckFlyer:
    """Return the flyer of this name."""
    settings, scenario = result.settings, world_flyers.select_fleet(result.run.scenario, count)
    for against in settings.against:
        if name == against:
            return world_flyers.BatchFlyer(scenario, against)
    (level,) = (level for level in settings.levels if name == level)
    return world_flyers.SitlFlyer(scenario, level, settings.source, settings.speed, settings.binary)


def _fly_worlds(
    flyer: SpotcheckFlyer,
    keys: Iterable[FlightKey],
    worlds: dict[int, World],
    out: Path,
    progress: Progress,
) -> None:
    for key in keys:
        world, name, count = key
        progress.describe(f"{name}, {count} robots, world {world}")
        done = 0.0

        def update_fraction(fraction: float) -> None:
            nonlocal done
            progress.advance(fraction - done)
            done = fraction

        new_flight = flyer.fly(world, worlds[world], update_fraction)
        flight.save_flight(folder.flight_path(out, *key), new_flight)
        update_fraction(1.0)


def _load_flights(result: SpotcheckResult, out: Path) -> dict[FlightKey, flight.SpotcheckFlight]:
    """Load all existing flights, including the recorded ones."""
    flights: dict[FlightKey, flight.SpotcheckFlight] = {}
    for pick in result.picks:
        for count in result.counts:
            flights[pick.world, RECORDED, count] = flight.load_recorded(
                result.run, pick.world, count
            )
            for name in (*result.settings.against, *result.settings.levels):
                path = folder.flight_path(out, pick.world, name, count)
                if path.is_file():
                    flights[pick.world, name, count] = flight.load_flight(path)
    return flights
