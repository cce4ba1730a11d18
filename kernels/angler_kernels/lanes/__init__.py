"""Functions of one body, run on many with one array for every element."""

from angler_kernels.lanes.table import Table
from angler_kernels.lanes.transform import (
    any_lane,
    apply,
    flatten,
    join,
    pack,
    repeat,
    split,
    spread,
)

__all__ = ["Table", "any_lane", "apply", "flatten", "join", "pack", "repeat", "split", "spread"]
