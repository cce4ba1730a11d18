"""Putting back what describes the arrays of an interrupted run, where it is missing or damaged."""

import json
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError


def mend(path: Path, fresh: Path) -> list[str]:
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
    mended = []
    for made in sorted(file for file in fresh.rglob("*") if file.is_file()):
        name = made.relative_to(fresh)
        place = path / name
        if name.name == "zarr.json" and (known := _essence(place)) is not None:
            if known != _essence(made):
                raise ConfigError(
                    f"{place}: does not describe what this run stores; put the right file back, or "
                    f"remove {place.parent}, and it is computed again"
                )
        elif not (place.is_file() and place.read_bytes() == made.read_bytes()):
            place.parent.mkdir(parents=True, exist_ok=True)
            made.replace(place)
            mended.append(str(name))
    return mended


def _essence(path: Path) -> dict[str, Any] | None:
    """What a description says of its array's bytes; None if it cannot be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    words = ("attributes", "dimension_names", "consolidated_metadata")
    return {key: value for key, value in found.items() if key not in words}
