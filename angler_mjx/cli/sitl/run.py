"""`angler sitl run`: a scenario on real ArduSub processes, from plan to run folder."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.cli.sitl.commands import CommandLevel, PositionSource, require_pymavlink
from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.teleop.opening import SessionOpener
    from angler_sitl.missions.flight import MissionFlight

_EXIT_INTERRUPTED = 130


def run(
    scenario: Annotated[str, tyro.conf.Positional],
    robots: int | None = None,
    world: int = 0,
    seed: int | None = None,
    level: CommandLevel = "guided",
    plan: tuple[str, ...] = ("grid",),
    source: PositionSource = "vision",
    speed: Literal["max"] | float = "max",
    duration: float | None = None,
    out: Path | None = None,
    on_crash: Literal["end", "hold"] = "end",
    gcs: str | None = None,
    isolate: bool = False,
    ardusub: Path | None = None,
    parameters: Path | None = None,
    mission: tuple[Path, ...] = (),
    origin: str | None = None,
    device: Device = "cpu",
) -> None:
    """Fly a world of a scenario on real ArduSub processes, and write a run folder.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        robots: Number of robots, the first of the scenario; if it has fewer, more of its last kind.
        world: Index of the world.
        seed: Seed of the run; the scenario's if left out.
        level: Command level. thrusters: signals of our own controllers; guided: targets for
            ArduSub's. The other levels are driven by hand: angler teleop --session sitl.
        plan: grid for the planner's paths, or JSON files of JointTrajectories: one file with all
            robots or one file for each. Robots in none of them follow the planner's path.
        source: Source of ArduSub's position.
        speed: Max speed as a multiple of real time.
        duration: Duration of the scene in s, even if all robots have ended; until all robots have
            ended or the horizon if left out.
        out: Run folder to make; runs/NAME-sitl if left out.
        on_crash: After the loss of one ArduSub: end the run, or let the others continue.
        gcs: Ground station that may connect, as in udp:127.0.0.1:14550.
        isolate: Run in a network namespace, where no socket can be reached from outside.
        ardusub: ArduSub binary; if left out, that of ANGLER_ARDUSUB, else the installed one.
        parameters: File with parameters of ArduSub, as angler tune, MAVProxy, Mission Planner and
            QGroundControl write them, for all robots.
        mission: Mission files, one for each robot, that ArduSub flies in AUTO; the batch simulator
            flies their plans, and the gap is printed.
        origin: Latitude and longitude of the origin of the world for missions; their home if left
            out.
        device: Device to compute on.
    """
    require_sitl(isolate=isolate, gcs=gcs)
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import build_scenario
    from angler_mjx.cli.shared.origin import parse_origin
    from angler_mjx.cli.sitl.status_table import status_table
    from angler_sitl.missions import mission as missions
    from angler_sitl.scene import motion
    from angler_sitl.scene.scenario_options import select_scenario

    motion.compute_inline()
    loaded = build_scenario(scenario, seed=seed)
    selected = select_scenario(loaded, robots)
    settings = missions.MissionSettings(
        out=out or Path("runs") / f"{selected.name}-sitl",
        world=world,
        level=level,
        source=source,
        plan=plan,
        speed=speed,
        on_crash=on_crash,
        duration_s=duration,
        gcs=gcs,
        binary=ardusub,
        parameters=parameters,
        missions=mission,
        origin=None if origin is None else parse_origin(origin),
    )
    flight, run_folder = missions.run_mission(
        selected, settings, partial(print, file=sys.stderr), status_table
    )
    _print_flight(flight)
    print(run_folder.path)
    if flight.by_signal:
        print("angler: interrupted; what was flown until then is kept", file=sys.stderr)
        sys.exit(_EXIT_INTERRUPTED)


def require_sitl(*, isolate: bool, gcs: str | None) -> None:
    """Check the requirements of real autopilots, and isolate the network if requested.

    Call before any import that starts threads: see `angler_sitl.firmware.isolation`.

    Raises:
        ConfigError: a ground station is to connect to an isolated network.
        UnsupportedError: pymavlink is not installed, or the system gives no network namespace.
    """
    require_pymavlink()
    if not isolate:
        return
    if gcs is not None:
        raise ConfigError(f"--gcs {gcs}: with --isolate nobody can join; leave out one of them")
    from angler_sitl.firmware import isolation

    isolation.isolate_network()


def build_opener(
    *, level: CommandLevel, source: PositionSource, gcs: str | None, ardusub: Path | None
) -> "SessionOpener":
    """Return the opener of real autopilots for `angler teleop`; arguments as of `run`."""
    from angler_sitl.scene import motion
    from angler_sitl.teleop_opener import build_session_opener as of_autopilots

    motion.compute_inline()
    return of_autopilots(level=level, source=source, gcs=gcs, binary=ardusub)


def _print_flight(flight: "MissionFlight") -> None:
    """Print the result of a flight, in a line for all and a line for each robot."""
    print(
        f"{flight.scene_s:.2f} s of the scene in {flight.wall_s:.2f} s "
        f"({flight.real_time:.1f} times real time)"
    )
    for i, status in enumerate(flight.last.status):
        note = f", {status.note}" if status.note else ""
        print(f"robot_{i}: {status.outcome.name.lower()}{note}")
