"""Functions of one body, run on many with one array for every element."""

from angler_kernels.lanes.folding import reciprocals
from angler_kernels.lanes.table import Table
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
    "Table",
    "any_lane",
    "apply",
    "flatten",
    "join",
    "pack",
    "reciprocals",
    "repeat",
    "split",
    "spread",
    "where",
]
