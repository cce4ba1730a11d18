"""Many runs of one scenario against each other: sweeps over its keys, and two runs, paired."""
