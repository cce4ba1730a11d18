"""Arrays of the Zarr groups of a run."""

import zarr
from zarr.types import AnyArray


def stored_group(group: zarr.Group, name: str) -> zarr.Group:
    """Return a group inside a group.

    Raises:
        KeyError: the group has no group of this name.
    """
    node = group[name]
    if not isinstance(node, zarr.Group):
        raise KeyError(name)
    return node


def stored_array(group: zarr.Group, name: str) -> AnyArray:
    """Return an array of a group.

    Raises:
        KeyError: the group has no array of this name.
    """
    node = group[name]
    if not isinstance(node, zarr.Array):
        raise KeyError(name)
    return node
