"""Draws by their seeds: one in words, and all that did not keep station as a table."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from angler_mjx.errors import RunError
from angler_mjx.studies.trials.samples import TrialVerdict
from angler_mjx.studies.trials.trial import Trial


def write_samples(path: Path, trials: Sequence[Trial]) -> None:
    """Seeds of all draws that did not keep station, a row for each outcome of each vehicle.

    Raises:
        RunError: the file cannot be written.
    """
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["controller", "vehicle", "parameter_set", "outcome", "count", "seeds"])
            for trial in trials:
                for key in sorted({_outcome_key(verdict) for verdict in trial.verdicts}):
                    kind, outcome = key
                    seeds = [v.sample.seed for v in trial.verdicts if _outcome_key(v) == key]
                    if outcome != "station":
                        row = [trial.controller, *kind, outcome, len(seeds)]
                        table.writerow([*row, " ".join(map(str, seeds))])
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error


def format_verdict(controller: str, verdict: TrialVerdict) -> str:
    """One draw in words."""
    sample = verdict.sample
    speed, course = np.linalg.norm(sample.current_mps), np.arctan2(*sample.current_mps[1::-1])
    return (
        f"{controller}, draw {sample.seed}: {sample.kind.label}, {sample.battery_v:.1f} V, current "
        f"{speed:.2f} m/s towards {math.degrees(course):.0f} degrees, step "
        f"({', '.join(f'{x:.2f}' for x in sample.step_m)}) m and "
        f"{math.degrees(sample.yaw_rad):.0f} degrees: {verdict.outcome}"
        + (f" ({verdict.fault})" if verdict.fault else "")
        + f"; leans {math.degrees(verdict.tilt_rad):.1f} degrees and turns at "
        f"{verdict.rate_radps:.2f} rad/s at most, at the end {verdict.end_rate_radps:.3f} rad/s "
        f"and {verdict.distance_m:.3f} m from its target"
    )


def _outcome_key(verdict: TrialVerdict) -> tuple[tuple[str, str], str]:
    kind = verdict.sample.kind
    return (kind.vehicle, kind.parameter_set), verdict.outcome
