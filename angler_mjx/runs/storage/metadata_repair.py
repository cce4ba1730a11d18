"""Putting back what describes the arrays of an interrupted run, where it is missing or damaged."""

import json
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError


def repair_metadata(path: Path, fresh: Path) -> list[str]:
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
    repaired = []
    for fresh_file in sorted(file for file in fresh.rglob("*") if file.is_file()):
        name = fresh_file.relative_to(fresh)
        target = path / name
        if name.name == "zarr.json" and (stored := _read_essentials(target)) is not None:
            if stored != _read_essentials(fresh_file):
                raise ConfigError(
                    f"{target}: does not describe what this run stores; put the right file back, "
                    "or "
                    f"remove {target.parent}, and it is computed again"
                )
        elif not (target.is_file() and target.read_bytes() == fresh_file.read_bytes()):
            target.parent.mkdir(parents=True, exist_ok=True)
            fresh_file.replace(target)
            repaired.append(str(name))
    return repaired


def _read_essentials(path: Path) -> dict[str, Any] | None:
    """What a description says of its array's bytes; None if it cannot be read."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(table, dict):
        return None
    ignored = ("attributes", "dimension_names", "consolidated_metadata")
    return {key: value for key, value in table.items() if key not in ignored}
