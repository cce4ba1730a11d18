"""What is written beside every row: where it was measured, and how far from the device's limits."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

from angler_mjx.runs.provenance import describe_environment
from angler_mjx.studies.speed.roofline import DeviceSpeed, bound
from angler_mjx.studies.speed.rows import SpeedRow


def around(device: DeviceSpeed) -> dict[str, Any]:
    """Device with its measured limits and driver, versions, machine, commit and command.

    Rows are for others to read: of absolute paths in the command the last name is kept.
    """
    found = {**describe_environment(), **asdict(device)}
    words = shlex.split(found["command"])
    named = [Path(word).name if Path(word).is_absolute() else word for word in words]
    return {**found, "command": shlex.join(named)}


def complete(row: SpeedRow, device: DeviceSpeed) -> dict[str, Any]:
    """The roofline of a row in its own unit, and the share of it that was reached."""
    highest = bound(row, device)
    reached = None if highest is None or row.median is None else row.median / highest
    return {"bound": highest, "share_of_bound": reached}
