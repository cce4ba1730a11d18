"""A dataset in another format: into a folder that is there whole or not at all."""

from collections.abc import Callable
from pathlib import Path

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets.exports import flights, lerobot, minari, mpinets, parquet
from angler_mjx.learning.datasets.reading.dataset import open_dataset
from angler_mjx.runs.storage import output_lock

type WriteDataset = Callable[..., None]

FORMATS: dict[str, WriteDataset] = {
    "lerobot": lerobot.write_dataset,
    "minari": minari.write_dataset,
    "mpinets": mpinets.write_dataset,
    "parquet": parquet.write_dataset,
}
"""By their names on the command line."""


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
        out: folder to make.
        to: one of `FORMATS`.
        action: what a robot did; see `flights.ACTIONS`.
        split: only this one.
        success: only episodes in which the whole team arrived, or only the others.
        progress: told how many flights are written, and of how many.

    Raises:
        ConfigError: there is no such dataset, format, action or split, or the folder is taken.
        UnsupportedError: the format's library is not installed.
        RunError: the disk gave out.
    """
    if to not in FORMATS:
        raise ConfigError(f"--to {to}: must be one of {', '.join(FORMATS)}")
    data = open_dataset(root, split=split, success=success, fields=flights.REQUIRED_FIELDS)
    flights.action_names(data, action)
    n_flights = flights.count_flights(data)
    lock = output_lock.acquire(out, kind="export", advise=lambda _: None)
    try:
        FORMATS[to](data, lock.building, action, lambda done: progress(done, n_flights))
    except OSError as error:
        lock.withdraw()
        raise RunError(f"--out {out}: cannot be written ({error.strerror or error})") from error
    except BaseException:
        lock.withdraw()
        raise
    lock.publish()
    return out
