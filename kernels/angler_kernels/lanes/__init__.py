"""Functions of one body, evaluated on many with one array for every element."""

from angler_kernels.lanes.folding import Instructions, use_instructions
from angler_kernels.lanes.sharing import compute_shared
from angler_kernels.lanes.table import LookupTable
from angler_kernels.lanes.transform import apply
from angler_kernels.lanes.trees import (
    UnsupportedOperationError,
    any_lane,
    broadcast_like,
    flatten,
    join,
    pack,
    repeat,
    select_lanes,
    split,
)

__all__ = [
    "Instructions",
    "LookupTable",
    "UnsupportedOperationError",
    "any_lane",
    "apply",
    "broadcast_like",
    "compute_shared",
    "flatten",
    "join",
    "pack",
    "repeat",
    "select_lanes",
    "split",
    "use_instructions",
]
