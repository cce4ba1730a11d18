"""Folder of a spot check: ``spotcheck.json``, ``flights/``, and the report.

``spotcheck.json`` holds the request and the picked worlds. Each flight is written when it ends, so
an interrupted spot check resumes with ``--resume`` after the last complete flight.
"""

from pathlib import Path
from typing import TypedDict

from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable
from angler_mjx.runs.storage import output_lock, results_folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors

ADVICE = "put back a copy of it, or begin a new spot check"
TABLE, FLIGHTS = "spotcheck.json", "flights"
FOLDER_KIND = "spot check"


class PickEntry(TypedDict):
    """Picked world, and the reason."""

    world: int
    why: str


SpotcheckTable = TypedDict(  # noqa: UP013 - keys of files are no names
    "SpotcheckTable",
    {
        "asked": JsonTable,
        "complete": bool,
        "picks": list[PickEntry],
        "likeness": dict[str, str],
        "provenance": JsonTable,
    },
)
"""Content of ``spotcheck.json``: request, picked worlds, likeness of each rebuilt world."""


def create_folder(out: Path) -> OutputLock:
    """Claim the folder of a new spot check.

    Raises:
        ConfigError: it exists, or its parent cannot be written.
    """
    output_lock.require_name(out, flag="--out")
    if (out / TABLE).is_file() and not load_table(out)["complete"]:
        raise ConfigError(
            f"--out {out}: an unfinished spot check lies there; take it up again with --resume or "
            "remove it"
        )
    return output_lock.acquire(out, kind=FOLDER_KIND, advise=results_folder.resumable_by(TABLE))


def reopen_folder(out: Path, request: JsonTable) -> tuple[OutputLock, SpotcheckTable]:
    """Take up an interrupted spot check, and its table; see `results_folder.resume_folder`.

    Args:
        out: its folder.
        request: current request.

    Raises:
        ConfigError: there is none, it is complete, or its request differs.
    """

    def check(building: Path) -> SpotcheckTable:
        table = load_table(building)
        results_folder.require_same_keys(building / TABLE, request, table["asked"])
        return table

    output_lock.require_name(out, flag="--resume")
    return results_folder.resume_folder(
        out,
        kind=FOLDER_KIND,
        file=TABLE,
        is_complete=(out / TABLE).is_file() and load_table(out)["complete"],
        check=check,
    )


def load_table(out: Path) -> SpotcheckTable:
    """Load ``spotcheck.json``.

    Raises:
        ConfigError: it is damaged.
    """
    path = out / TABLE
    table = read_table(path, ADVICE)
    with wrap_read_errors(path, ADVICE):
        if not isinstance(table["complete"], bool) or not isinstance(table["asked"], dict):
            raise TypeError("complete or asked are not what they should be")
        for pick in table["picks"]:
            if not isinstance(pick["world"], int) or not isinstance(pick["why"], str):
                raise TypeError("picks holds something else than worlds")
        return {
            "asked": table["asked"],
            "complete": table["complete"],
            "picks": table["picks"],
            "likeness": table.get("likeness", {}),
            "provenance": table.get("provenance", {}),
        }


def save_table(out: Path, table: SpotcheckTable) -> None:
    """Write ``spotcheck.json`` atomically."""
    write_json(out / TABLE, table, indent=1)


def flight_path(out: Path, world: int, name: str, robots: int) -> Path:
    """Return the path of a flight.

    Args:
        out: the folder.
        world: global index.
        name: of the flight.
        robots: number of robots.
    """
    return out / FLIGHTS / f"world_{world:06d}" / f"{name}_{robots}.npz"
