"""What became known of a dataset after it was made, put beside its manifest and into its card."""

from pathlib import Path

from angler_mjx.errors import RunError
from angler_mjx.learning.datasets import card, gaps, index, manifest, sums
from angler_mjx.learning.datasets.gaps import SpotCheck


def spotcheck(place: Path, found: SpotCheck) -> None:
    """Add a spot check, or replace an older one; sums of all other files stay as they were.

    Args:
        place: the dataset.
        found: the spot check.

    Raises:
        ConfigError: it is no dataset, its list of sums is damaged.
        RunError: the disk gave out.
    """
    whole = manifest.read(place)
    table = index.read(place)
    said = sums.read(place, whole.sums)
    try:
        gaps.write(place, found)
        card.write_text(place, whole, table)
        digest = sums.renew(place, said, (gaps.FILE, card.README))
        manifest.write(place, whole.model_copy(update={"sums": digest}))
    except OSError as error:
        raise RunError(
            f"{place}: cannot be written ({error.strerror or error}); make room and write it again"
        ) from error
