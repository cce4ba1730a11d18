"""Ways through moving water that take least energy or least time, in batches on the device."""
