"""Files of ocean models: fields of velocity by CF conventions, and sea floors.

`cf` reads a NetCDF file and says what its variables and axes are; `field` makes a field of it that
programs hold.
"""

from angler_mjx.world.ocean.field import Field, load

__all__ = ["Field", "load"]
