"""The `angler` command: its subcommands, and its error messages and exit codes.

JAX is imported only by the commands that compute, so that `angler --help` prints at once.
"""

import gc
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import TextIO

import tyro

from angler_mjx import __version__
from angler_mjx.cli import (
    bench,
    control,
    doctor,
    env,
    export,
    fly,
    gallery,
    leaderboard,
    mission,
    replay,
    rollout,
    scenarios,
    serve,
    teleop,
    tune,
    validate,
    vehicle,
    verify,
    warm,
)
from angler_mjx.cli.datasets import commands as dataset
from angler_mjx.cli.planners import benchmark, plan
from angler_mjx.cli.sitl import commands as sitl
from angler_mjx.cli.sitl import run as sitl_run
from angler_mjx.cli.sitl import spotcheck
from angler_mjx.cli.studies import compare, fleet_size, sweep
from angler_mjx.errors import AnglerError
from angler_mjx.files import RenamedKeyWarning

EXIT_FAULT, EXIT_INTERRUPTED, EXIT_BROKEN_PIPE = 2, 130, 141

GC_THRESHOLDS = (100_000, 20, 20)
"""Thresholds of Python's garbage collector. With the default ones it runs 900 times while JAX
traces a computation, frees almost nothing, and takes a fifth of that time."""

LOG_LEVEL = ("TF_CPP_MIN_LOG_LEVEL", "3")
"""Level of XLA's own log on stderr, read when JAX is imported; a level that is already set is kept.
From 2 minutes on, XLA logs every compilation as an error, "Very slow compile? If you want to file a
bug", and has no other switch. Its true errors reach Python as exceptions, and fatal ones are
logged."""

GROUPS: dict[str, dict[str, Callable[..., None]]] = {
    "dataset": {
        "make": dataset.make_dataset,
        "show": dataset.show_dataset,
        "verify": dataset.verify_dataset,
        "repair": dataset.repair_dataset,
        "merge": dataset.merge_datasets,
        "export": dataset.export_dataset,
        "stats": dataset.show_stats,
    },
    "env": {"make": env.make_environments, "show": env.show_environment},
    "leaderboard": {
        "problems": leaderboard.write_problems,
        "plan": leaderboard.plan,
        "check": leaderboard.check,
        "build": leaderboard.build,
        "baselines": leaderboard.make_baselines,
        "films": leaderboard.film,
    },
    "mission": {"import": mission.import_mission, "export": mission.export_mission},
    "sitl": {
        "install": sitl.install_ardusub,
        "doctor": sitl.run_doctor,
        "run": sitl_run.run,
        "parameters": sitl.write_parameters,
    },
    "scenarios": {
        "list": scenarios.list_scenarios,
        "show": scenarios.show_scenario,
        "reference": scenarios.print_reference,
        "import": scenarios.import_problem,
    },
    "study": {"fleet_size": fleet_size.fleet_size},
    "vehicle": {
        "list": vehicle.list_vehicles,
        "show": vehicle.show_vehicle,
        "check": vehicle.check_vehicle,
        "export": vehicle.export_mjcf,
        "import": vehicle.import_vehicle,
    },
}
"""Commands of two words."""

DEFAULT_SUBCOMMANDS = {"scenarios": "list"}
"""Default subcommand of a group."""


def _env_group() -> None:
    """Generate environments into a file, and render one of them."""


def _leaderboard_group() -> None:
    """Write the frozen problems of ANGLER-1, plan and judge submissions, build their board."""


def _mission_group() -> None:
    """Import missions of ground stations as scenarios and plans, export plans as missions."""


def _sitl_group() -> None:
    """Install ArduSub, check whether it runs here, fly scenarios on it, write its parameters."""


def _scenarios_group() -> None:
    """List the shipped scenarios, print one, import problems, print the keys of files."""


def _study_group() -> None:
    """Answer a question with as many worlds as it needs, such as the team size of a task."""


def _vehicle_group() -> None:
    """List, show and check vehicles, export the MuJoCo model of one, import others."""


def _dataset_group() -> None:
    """Make datasets of flights for learning planners, verify and show them."""


COMMANDS: dict[str, Callable[..., None]] = {
    "rollout": rollout.rollout,
    "plan": plan.plan,
    "problems": plan.write_problems,
    "warm": warm.warm,
    "scenarios": _scenarios_group,
    "figures": rollout.figures,
    "replay": replay.replay,
    "gallery": gallery.gallery,
    "sweep": sweep.sweep,
    "compare": compare.compare,
    "study": _study_group,
    "verify": verify.verify,
    "export": export.export,
    "teleop": teleop.teleop,
    "serve": serve.serve,
    "doctor": doctor.run_doctor,
    "fly": fly.fly,
    "env": _env_group,
    "dataset": _dataset_group,
    "mission": _mission_group,
    "sitl": _sitl_group,
    "spotcheck": spotcheck.spotcheck,
    "vehicle": _vehicle_group,
    "benchmark": benchmark.benchmark,
    "leaderboard": _leaderboard_group,
    "bench": bench.bench,
    "control": control.control,
    "tune": tune.tune,
    "validate": validate.validate,
}
"""Commands of one word; groups are listed here for the help text only."""


RENAMED_FLAGS = {
    "--draw": "--sample",
    "--draws": "--samples",
    "--knows": "--information",
    "--most-minutes": "--max-minutes",
    "--most-worlds": "--max-worlds",
}
"""Flags by their names before 0.2, accepted until 1.0 with a note on stderr."""


def _rename_flag(argument: str) -> str:
    name, sign, value = argument.partition("=")
    today = RENAMED_FLAGS.get(name.replace("_", "-"))
    if today is None:
        return argument
    print(f"angler: {name} is {today} since 0.2; the old flag works until 1.0", file=sys.stderr)
    return f"{today}{sign}{value}"


_show_warning = warnings.showwarning


def _print_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning on a file's key as a message of the command; any other as Python does."""
    if issubclass(category, RenamedKeyWarning):
        print(f"angler: {message}", file=sys.stderr)
    else:
        _show_warning(message, category, filename, lineno, file, line)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command.

    Exits with 0 on success, with 2 and one message on stderr when an input cannot be used, a run
    cannot go on or a planner raised in every world, with 130 when interrupted, with 141 when the
    reader of its output has closed it, and with 1 after a traceback: a fault of angler itself, to
    be reported, or of a planner under debugging.
    """
    # A cluster's stop signal ends the command as cleanly as Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    gc.set_threshold(*GC_THRESHOLDS)
    os.environ.setdefault(*LOG_LEVEL)
    warnings.showwarning = _print_warning
    args = [_rename_flag(arg) for arg in (sys.argv[1:] if arguments is None else arguments)]
    prog, commands = "angler", COMMANDS
    if args == ["--version"]:
        print(f"angler {__version__}")
        return
    if len(args) == 1 and args[0] in DEFAULT_SUBCOMMANDS:
        args.append(DEFAULT_SUBCOMMANDS[args[0]])
    if args and args[0] in GROUPS:
        prog, commands = f"angler {args[0]}", GROUPS[args.pop(0)]
    try:
        try:
            tyro.extras.subcommand_cli_from_dict(
                commands,
                prog=prog,
                description="Underwater multi-robot simulation in batches, on JAX and MJX. "
                "angler --version tells which.",
                args=args,
                config=(tyro.conf.OmitArgPrefixes,),
            )
        except SystemExit:  # --help ends this way, with its text still unwritten
            sys.stdout.flush()
            raise
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader closed the pipe (angler --help | head): the rest of the output is dropped.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_BROKEN_PIPE)
    except AnglerError as error:
        print(f"angler: {error}", file=sys.stderr)
        sys.exit(EXIT_FAULT)
    except KeyboardInterrupt:
        print("angler: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
