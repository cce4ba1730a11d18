"""`angler teleop`: robots of one world driven from the keyboard, or by a file of timed keys."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.cli.sitl.commands import CommandLevel, PositionSource
from angler_mjx.cli.sitl.run import build_opener as real_autopilots
from angler_mjx.cli.sitl.run import require_sitl
from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.teleop.loop import DriveResult


def teleop(
    scenario: Annotated[str, tyro.conf.Positional],
    robots: str | None = None,
    session: Literal["batch", "sitl"] = "batch",
    script: Path | None = None,
    realtime: bool = False,
    out: Path | None = None,
    world: int = 0,
    seed: int | None = None,
    rerun: bool = False,
    duration: float | None = None,
    speed: float = 0.5,
    turn: float = 0.5,
    silence: float = 0.8,
    level: CommandLevel | None = None,
    source: PositionSource | None = None,
    gcs: str | None = None,
    isolate: bool = False,
    ardusub: Path | None = None,
    device: Device = "cpu",
) -> None:
    """Drive robots of one world by keys while the others follow their plans.

    The keys are those of teleop_twist_keyboard; ? shows them, Q ends.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        robots: Robots to drive, as in 0,2; all if left out. Tab selects the next robot.
        session: Vehicles: simulated, or real autopilots.
        script: File of timed keys instead of the keyboard.
        realtime: Run a script at real time instead of as fast as possible; the keyboard always runs
            at real time.
        out: Run folder to make, for figures, replays and exports.
        world: Index of the world.
        seed: Seed of the run; the scenario's if left out.
        rerun: Open the Rerun viewer beside the terminal; with --out, save the replay there too.
        duration: Seconds to drive; until Q or the end of the script if left out.
        speed: Initial linear speed, m/s.
        turn: Initial angular speed, rad/s.
        silence: Seconds without a key after which a driven robot stops. Driving stutters if it is
            below the repeat delay of the keyboard.
        level: For --session sitl, the command level: sticks (poshold if left out, althold, manual),
            targets (guided), or the signals of our own controllers (thrusters).
        source: For --session sitl, the source of ArduSub's position; vision if left out.
        gcs: For --session sitl, a ground station that may connect, as in udp:127.0.0.1:14550.
        isolate: For --session sitl, run in a network namespace of its own.
        ardusub: For --session sitl, the ArduSub binary; if left out, that of ANGLER_ARDUSUB, else
            the installed one.
        device: Device to compute on.
    """
    sitl_flags = {"level": level, "source": source, "gcs": gcs, "ardusub": ardusub}
    sitl_only = [
        *(f for f, value in sitl_flags.items() if value is not None),
        *["isolate"] * isolate,
    ]
    if session == "batch" and sitl_only:
        raise ConfigError(f"--{sitl_only[0]}: only real autopilots have that; add --session sitl")
    if session == "sitl":
        require_sitl(isolate=isolate, gcs=gcs)
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import build_scenario
    from angler_mjx.teleop import driving, opening

    settings = driving.TeleopSettings(
        robots=robots,
        script=script,
        realtime=realtime,
        out=out,
        world=world,
        rerun=rerun,
        duration_s=duration,
        speed_mps=speed,
        turn_radps=turn,
        silence_s=silence,
    )
    loaded = build_scenario(scenario, seed=seed)
    opener: opening.SessionOpener = opening.open_simulated
    if session == "sitl":
        opener = real_autopilots(
            level=level or "poshold", source=source or "vision", gcs=gcs, ardusub=ardusub
        )
    report = partial(print, file=sys.stderr)
    result, run = driving.run_teleop(loaded, settings, report=report, opener=opener)
    _print_drive(result)
    if run is not None:
        print(run.path)


def _print_drive(result: "DriveResult") -> None:
    """Print the result of a drive, in a line for all and a line for each robot."""
    pace = "as fast as possible" if result.overruns is None else str(result.overruns)
    print(
        f"{result.scene_s:.2f} s of the scene in {result.wall_s:.2f} s, {result.steps} steps, "
        f"{pace}"
    )
    for i, status in enumerate(result.last.status):
        refused = f", refused: {status.refused}" if status.refused else ""
        print(f"robot_{i}: {status.outcome.name.lower()}{refused}")
