"""Windows for Grain, the only module that imports it.

`build_source` gives a `grain.MapDataset`: shuffle, batch and map it as any other. Its iterators
store their position (``get_state``) and resume from it.
"""

from angler_mjx.errors import UnsupportedError
from angler_mjx.learning.datasets.windows import Windows

try:
    import grain
except ImportError as error:
    raise UnsupportedError("Grain is not installed: pip install grain") from error


def build_source(windows: Windows) -> grain.MapDataset:
    """Return all windows, in order, as a `grain.MapDataset`."""
    return grain.MapDataset.source(windows)
