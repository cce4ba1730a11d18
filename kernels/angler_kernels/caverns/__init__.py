"""Connected free regions of a 3-D grid."""

from angler_kernels.caverns.reference import component_labels, largest_cavern

__all__ = ["component_labels", "largest_cavern"]
