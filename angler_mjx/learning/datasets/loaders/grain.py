"""Windows for Grain, which is imported here and nowhere else.

`build_source` gives a `grain.MapDataset`: shuffle, batch and map it as any other. Its iterators say
where they are (``get_state``), and go on from there.
"""

from typing import Any

from angler_mjx.errors import UnsupportedError
from angler_mjx.learning.datasets.reading.windows import Windows

try:
    import grain
except ImportError as error:
    raise UnsupportedError("Grain is not installed: pip install grain") from error


def build_source(windows: Windows) -> Any:
    """All windows, in order, as a `grain.MapDataset`."""
    return grain.MapDataset.source(windows)
