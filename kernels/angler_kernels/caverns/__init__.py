"""Connected free regions of a 3-D grid."""

from angler_kernels.caverns.reference import largest_cavern

__all__ = ["largest_cavern"]
