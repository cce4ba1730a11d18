"""Export of a dataset to another format: the folder appears complete or not at all."""

from collections.abc import Callable
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.dataset import open_dataset
from angler_mjx.learning.datasets.exports import flights, lerobot, minari, mpinets, parquet
from angler_mjx.runs.storage import results_folder

type WriteDataset = Callable[..., None]

FORMATS: dict[str, WriteDataset] = {
    "lerobot": lerobot.write_dataset,
    "minari": minari.write_dataset,
    "mpinets": mpinets.write_dataset,
    "parquet": parquet.write_dataset,
}
"""Formats by their names on the command line."""


def export_dataset(
    root: Path,
    out: Path,
    *,
    to: str,
    action: str = "target",
    split: str | None = None,
    success: bool | None = None,
    progress: Callable[[int, int], None],
) -> Path:
    """Write a dataset in another format.

    Args:
        root: the dataset, or a run folder.
        out: folder to create.
        to: one of `FORMATS`.
        action: action of a robot; see `flights.ACTIONS`.
        split: only this split; all if None.
        success: only episodes in which the whole team arrived, or only the others.
        progress: called with the numbers of written flights and of all flights.

    Raises:
        ConfigError: the dataset, format, action or split does not exist, or the folder does.
        UnsupportedError: the format's library is not installed.
        RunError: writing failed.
    """
    if to not in FORMATS:
        raise ConfigError(f"--to {to}: must be one of {', '.join(FORMATS)}")
    data = open_dataset(root, split=split, success=success, fields=flights.REQUIRED_FIELDS)
    flights.action_names(data, action)
    n_flights = flights.count_flights(data)
    with results_folder.build_folder(out, kind="export") as building:
        FORMATS[to](data, building, action, lambda done: progress(done, n_flights))
    return out
