"""A scenario made runnable: worlds drawn and planned, compiled steps, devices."""
