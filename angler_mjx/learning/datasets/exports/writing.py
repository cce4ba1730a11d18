"""A dataset in another format: into a folder that is there whole or not at all."""

from collections.abc import Callable
from pathlib import Path

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets.exports import flights, lerobot, minari, mpinets, parquet
from angler_mjx.learning.datasets.reading.dataset import open_dataset
from angler_mjx.runs.storage import output_lock

type Write = Callable[..., None]

FORMATS: dict[str, Write] = {
    "lerobot": lerobot.write,
    "minari": minari.write,
    "mpinets": mpinets.write,
    "parquet": parquet.write,
}
"""By their names on the command line."""


def export(
    place: Path,
    out: Path,
    *,
    to: str,
    action: str = "target",
    split: str | None = None,
    success: bool | None = None,
    tell: Callable[[int, int], None],
) -> Path:
    """Write a dataset in another format.

    Args:
        place: the dataset, or a run folder.
        out: folder to make.
        to: one of `FORMATS`.
        action: what a robot did; see `flights.ACTIONS`.
        split: only this one.
        success: only episodes in which the whole team arrived, or only the others.
        tell: told how many flights are written, and of how many.

    Raises:
        ConfigError: there is no such dataset, format, action or split, or the folder is taken.
        UnsupportedError: the format's library is not installed.
        RunError: the disk gave out.
    """
    if to not in FORMATS:
        raise ConfigError(f"--to {to}: must be one of {', '.join(FORMATS)}")
    data = open_dataset(place, split=split, success=success, fields=flights.NEEDED)
    flights.action_names(data, action)
    most = flights.count(data)
    claimed = output_lock.acquire(out, what="export", left=lambda _: None)
    try:
        FORMATS[to](data, claimed.building, action, lambda done: tell(done, most))
    except OSError as error:
        claimed.withdraw()
        raise RunError(f"--out {out}: cannot be written ({error.strerror or error})") from error
    except BaseException:
        claimed.withdraw()
        raise
    claimed.publish()
    return out
