"""The `angler` command: its subcommands, and how an error reaches a person.

JAX is imported only by the commands that compute, so that `angler --help` answers at once.
"""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import tyro

from angler_mjx.cli import bench, env, rollout, vehicle
from angler_mjx.errors import AnglerError

EXIT_FAULT, EXIT_INTERRUPTED = 2, 130

COMMANDS: dict[str, Callable[..., Any]] = {
    "rollout": rollout.rollout,
    "scenarios": rollout.scenarios,
    "figures": rollout.figures,
    "replay": rollout.replay,
    "env make": env.make,
    "env show": env.show,
    "vehicle list": vehicle.list_,
    "vehicle show": vehicle.show,
    "vehicle export": vehicle.export,
    "bench": bench.bench,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command.

    Exits with 0 when it is done, with 2 and one message on stderr when something given to it cannot
    be used, with 130 when it was interrupted.
    """
    try:
        tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="angler",
            description="Underwater multi-robot simulation in batches, on JAX and MJX.",
            args=arguments,
            config=(tyro.conf.OmitArgPrefixes,),
        )
    except AnglerError as error:
        print(f"angler: {error}", file=sys.stderr)
        sys.exit(EXIT_FAULT)
    except KeyboardInterrupt:
        print("angler: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
