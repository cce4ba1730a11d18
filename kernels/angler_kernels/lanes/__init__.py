"""Functions of one body, evaluated on many with one array for every element."""

from angler_kernels.lanes.folding import Instructions, use_instructions
from angler_kernels.lanes.shaping import read_elements
from angler_kernels.lanes.sharing import compute_shared
from angler_kernels.lanes.table import LaneValue, LoadFunction, LookupTable, MemoryIndex
from angler_kernels.lanes.transform import apply
from angler_kernels.lanes.trees import (
    Elements,
    UnsupportedOperationError,
    any_lane,
    broadcast_like,
    flatten,
    join,
    pack,
    repeat,
    select_lanes,
    split,
    split_leaf,
)

__all__ = [
    "Elements",
    "Instructions",
    "LaneValue",
    "LoadFunction",
    "LookupTable",
    "MemoryIndex",
    "UnsupportedOperationError",
    "any_lane",
    "apply",
    "broadcast_like",
    "compute_shared",
    "flatten",
    "join",
    "pack",
    "read_elements",
    "repeat",
    "select_lanes",
    "split",
    "split_leaf",
    "use_instructions",
]
