"""Files of ocean models: fields of velocity by CF conventions, and sea floors.

`cf` reads a NetCDF file and identifies its variables and axes; `field` turns it into a field that
programs hold, `floor` into a sea floor; `deepest_cells` gives positions of worlds in fields.
"""

from angler_mjx.world.ocean.field import OceanField, load_field
from angler_mjx.world.ocean.floor import SeaFloor, load_floor

__all__ = ["OceanField", "SeaFloor", "load_field", "load_floor"]
