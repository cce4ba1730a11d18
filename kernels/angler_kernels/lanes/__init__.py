"""Functions of one body, run on many with one array for every element."""

from angler_kernels.lanes.folding import Instructions, instructions
from angler_kernels.lanes.sharing import shared
from angler_kernels.lanes.table import LookupTable
from angler_kernels.lanes.transform import apply
from angler_kernels.lanes.trees import (
    any_lane,
    flatten,
    join,
    pack,
    repeat,
    split,
    spread,
    where,
)

__all__ = [
    "Instructions",
    "LookupTable",
    "any_lane",
    "apply",
    "flatten",
    "instructions",
    "join",
    "pack",
    "repeat",
    "shared",
    "split",
    "spread",
    "where",
]
