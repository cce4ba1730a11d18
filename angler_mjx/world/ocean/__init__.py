"""Files of ocean models: fields of velocity by CF conventions, and sea floors.

`cf` reads a NetCDF file and says what its variables and axes are; `field` makes a field of it that
programs hold, `floor` a sea floor; `places` says where in them worlds may lie.
"""

from angler_mjx.world.ocean.field import OceanField, load_field
from angler_mjx.world.ocean.floor import SeaFloor, load_floor

__all__ = ["OceanField", "SeaFloor", "load_field", "load_floor"]
