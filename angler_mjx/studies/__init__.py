"""Many runs beside each other: sweeps, fleet sizes, benchmarks of planners, tuning, speed."""
