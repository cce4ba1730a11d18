"""Model predictive path integral control of a fleet: `policy.Mppi`."""
