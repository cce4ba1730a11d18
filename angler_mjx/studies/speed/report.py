"""What is written beside every row: where it was measured, and how far from the device's limits."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

from angler_mjx.runs.provenance import describe_environment
from angler_mjx.studies.speed.roofline import DeviceSpeed, compute_bound
from angler_mjx.studies.speed.rows import SpeedRow


def describe_conditions(device: DeviceSpeed) -> dict[str, Any]:
    """Device with its measured limits and driver, versions, machine, commit and command.

    Rows are for others to read: of absolute paths in the command the last name is kept.
    """
    conditions = {**describe_environment(), **asdict(device)}
    arguments = shlex.split(conditions["command"])
    names = [Path(word).name if Path(word).is_absolute() else word for word in arguments]
    return {**conditions, "command": shlex.join(names)}


def compare_with_bound(row: SpeedRow, device: DeviceSpeed) -> dict[str, Any]:
    """The roofline of a row in its own unit, and the share of it that was reached."""
    highest = compute_bound(row, device)
    reached = None if highest is None or row.median is None else row.median / highest
    return {"bound": highest, "share_of_bound": reached}
