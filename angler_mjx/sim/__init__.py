"""The simulator itself: state, one step, contact detection, outcomes."""
