"""The tables of docs/generated/control.md, put between its marks."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path

from angler_mjx.report.viewing import markdown_tables
from angler_mjx.report.viewing.markdown_tables import format_table
from angler_mjx.studies.flights import kinds, measures
from angler_mjx.studies.flights.samples import CURRENT_MPS, STEP_M
from angler_mjx.studies.trials import figure_of_eight, samples, steps, trial
from angler_mjx.studies.trials.figure_of_eight import FigureOfEight
from angler_mjx.studies.trials.steps import TrialStep
from angler_mjx.studies.trials.trial import Trial

BEGIN, END = "<!-- trials: begin -->", "<!-- trials: end -->"
_STILL, _CURRENT = steps.CURRENTS_MPS


def format_document(trials: Sequence[Trial], third_order: Sequence[TrialStep], images: str) -> str:
    """Everything between the marks.

    Args:
        trials: of each controller.
        third_order: steps of the cascade with rotors of third order; empty if not flown.
        images: folder of the figures, as seen from the document.
    """
    parts = ["## In short", _format_summary(trials)]
    if any(controller_trial.verdicts for controller_trial in trials):
        parts += ["## Random draws", _format_samples(trials)]
    if third_order:
        parts += ["## Rotors of third order", _format_third_order(third_order)]
    for controller_trial in trials:
        parts += [f"## {controller_trial.controller}", _format_controller(controller_trial, images)]
    return "\n\n".join(parts)


def require_marks(document: Path) -> None:
    """Refuse a document that `write_document` could not write into, before hours of flights.

    Raises:
        ConfigError: as `write_document`.
    """
    markdown_tables.require_marks(document, BEGIN, END)


def write_document(document: Path, body: str) -> None:
    """Put a text between the two marks of a document.

    Raises:
        ConfigError: the document cannot be read or written, or has no marks.
    """
    markdown_tables.replace_section(document, BEGIN, body, END)


def _format_summary(trials: Sequence[Trial]) -> str:
    loose = kinds.find_unstabilised()

    def of_steps(controller_trial: Trial, flow: float) -> str:
        held = [
            s for s in controller_trial.flown.steps if s.kind not in loose and s.current_mps == flow
        ]
        bad = sum(bool(trial.misses_of_step(s)) for s in held)
        worst = f"{_format_cm(max(s.error_m for s in held))} cm"
        turns = [s.error_rad for s in held if not math.isnan(s.error_rad)]
        if flow == _STILL and turns:
            worst += f", {_format_degrees(max(turns))}°"
        return worst + (f"; {bad} of {len(held)} miss" if bad else "")

    def of_eights(controller_trial: Trial, still: bool) -> str:
        flown = [
            e
            for e in controller_trial.eights
            if e.kind not in loose and (e.condition == figure_of_eight.CONDITIONS[0][0]) == still
        ]
        bad = sum(bool(trial.misses_of_eight(e)) for e in flown)
        worst = f"{_format_cm(max(e.error_m for e in flown))} cm"
        return worst + (f"; {bad} of {len(flown)} miss" if bad else "")

    rows = [
        [
            f"[{controller_trial.controller}](#{controller_trial.controller})",
            of_steps(controller_trial, _STILL),
            of_steps(controller_trial, _CURRENT),
            of_eights(controller_trial, True),
            of_eights(controller_trial, False),
        ]
        for controller_trial in trials
    ]
    without = "; ".join(sorted(kind.label for kind in loose)) or "none"
    head = [
        "controller",
        "step, still water (2 cm, 1°)",
        f"step, {_CURRENT:g} m/s from the side (5 cm)",
        "figure of eight, still water (5 cm)",
        "figure of eight, vortices, mass 20 % off (15 cm)",
    ]
    return (
        "Worst steady error after a step and worst RMS error of the figure of eight over all "
        f"vehicles that something holds level (left out: {without}); targets in brackets."
        f"\n\n{format_table(head, rows)}"
    )


def _format_samples(trials: Sequence[Trial]) -> str:
    rows, faults = [], []
    for controller_trial in trials:
        held = [
            v for v in controller_trial.verdicts if v.sample.kind not in kinds.find_unstabilised()
        ]
        unstabilised = [
            v for v in controller_trial.verdicts if v.sample.kind in kinds.find_unstabilised()
        ]
        counts, unstabilised_counts = trial.count_outcomes(held), trial.count_outcomes(unstabilised)
        rows.append(
            [
                controller_trial.controller,
                f"{len(held):,}",
                *(f"{counts[name]:,}" for name in ("station", "outrun", "away", "failed")),
                _format_degrees(max((v.tilt_rad for v in held), default=math.nan)),
                f"{max((v.rate_radps for v in held), default=math.nan):.2f}",
                f"{unstabilised_counts['failed']:,} of {len(unstabilised):,}",
            ]
        )
        faults += [
            f"- {controller_trial.controller}, seed {v.sample.seed}: {v.sample.kind.label}, "
            f"{v.fault}"
            for v in held
            if v.fault
        ]
    head = [
        "controller",
        "draws",
        "on station",
        "outrun",
        "away",
        "failed",
        "greatest tilt, °",
        "greatest rate, rad/s",
        "failed of those that nothing holds level",
    ]
    return "\n\n".join(
        [
            f"{len(trials[0].verdicts):,} draws of each controller: parameter set x battery "
            f"{samples.BATTERY_V[0]:g} to {samples.BATTERY_V[1]:g} V x current to "
            f"{CURRENT_MPS:g} m/s x every gain {100 * samples.GAIN_FRACTION:.0f} % up or down x a "
            f"step of up to {STEP_M:g} m and half a turn; {samples.FLIGHT_S:g} s each. Failed "
            f"is what leans more than {math.degrees(measures.TILT_RAD):.0f} degrees, turns faster "
            f"than {measures.RATE_RADPS:g} rad/s, or still turns faster than "
            f"{samples.QUIET_RADPS:g} rad/s in the last {samples.LAST_S:g} s. On station is within "
            f"{samples.STATION_M:g} m there; outrun is not, in a current above "
            f"{100 * samples.OUTRUN_FRACTION:.0f} % of the vehicle's slowest level "
            "terminal speed; away is not, in a slower one.",
            format_table(head, rows),
            "Failing draws of vehicles that something holds level: "
            + ("\n\n" + "\n".join(faults) if faults else "none."),
            "Seeds of all draws that did not keep station are in "
            "[control_draws.csv](control_draws.csv); `angler control --controller NAME --sample "
            "SEED` flies one again.",
        ]
    )


def _format_third_order(flown: Sequence[TrialStep]) -> str:
    return (
        "The cascade with rotors that answer as von Benzon et al. 2022 identified them "
        '(`rotor_response = "third_order"`), in place of the lag.\n\n' + _format_step_table(flown)
    )


def _format_controller(controller_trial: Trial, images: str) -> str:
    return "\n\n".join(
        [
            "![Step responses and figures of "
            f"eight]({images}/control_{controller_trial.controller}.png)",
            _format_gains(controller_trial.controller),
            _format_step_table(controller_trial.flown.steps),
            _format_eight_table(controller_trial.eights),
        ]
    )


def _format_gains(controller: str) -> str:
    spec = kinds.spec_of(controller)
    parts = []
    for stage, gains in zip(spec.stages, spec.gains, strict=True):
        numbers = [f"{entry.name} {getattr(gains, entry.name):g}" for entry in fields(gains)]
        if numbers:
            parts.append(f"`{stage.name}`: {', '.join(numbers)}")
    return "Gains. " + "; ".join(parts) + "."


def _format_step_table(flown: Sequence[TrialStep]) -> str:
    head = [
        "vehicle, set",
        "rise, s",
        "overshoot, %",
        "settling, s",
        "still: error, cm",
        "still: heading, °",
        f"{_CURRENT:g} m/s: error, cm",
        f"{_CURRENT:g} m/s: heading, °",
        "oscillates",
        "greatest tilt, °",
    ]
    rows = []
    for kind in dict.fromkeys(step.kind for step in flown):
        still = [s for s in flown if s.kind == kind and s.current_mps == _STILL]
        moving = [s for s in flown if s.kind == kind and s.current_mps == _CURRENT]
        swings = [f"{s.axis} still" for s in still if s.swings]
        swings += [f"{s.axis} current" for s in moving if s.swings]
        rows.append(
            [
                kind.label,
                _join_numbers(_format_number(s.rise_s, 1) for s in still),
                _join_numbers(_format_number(100 * s.overshoot, 0) for s in still),
                _join_numbers(_format_number(s.settling_s, 1) for s in still),
                _join_numbers(_format_cm(s.error_m) for s in still),
                _join_numbers(_format_degrees(s.error_rad) for s in still),
                _join_numbers(_format_cm(s.error_m) for s in moving),
                _join_numbers(_format_degrees(s.error_rad) for s in moving),
                ", ".join(swings) or "no",
                _format_degrees(max(s.tilt_rad for s in [*still, *moving])),
            ]
        )
    return (
        "Steps of "
        + " / ".join(dict.fromkeys(s.axis for s in flown))
        + ":\n\n"
        + (format_table(head, rows))
    )


def _format_eight_table(flown: Sequence[FigureOfEight]) -> str:
    names = [name for name, _, _ in figure_of_eight.CONDITIONS]
    rows = [
        [
            kind.label,
            *(
                _format_errors(next(e for e in flown if e.kind == kind and e.condition == name))
                for name in names
            ),
        ]
        for kind in dict.fromkeys(result.kind for result in flown)
    ]
    return "Figure of eight, RMS error in time / across the path, cm:\n\n" + format_table(
        ["vehicle, set", *names], rows
    )


def _format_errors(result: FigureOfEight) -> str:
    slow = "" if result.speed_mps == figure_of_eight.SPEED_MPS else f" ({result.speed_mps:g} m/s)"
    return f"{_format_cm(result.in_time_m)} / {_format_cm(result.across_m)}{slow}"


def _join_numbers(numbers: Iterable[str]) -> str:
    every = list(numbers)
    return "-" if set(every) == {"-"} else " / ".join(every)


def _format_number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _format_cm(metres: float) -> str:
    """Centimetres to a tenth, below a thousand."""
    return _format_number(100 * metres, 1) if not metres >= 10 else f"{100 * metres:.0f}"


def _format_degrees(radians: float) -> str:
    return _format_number(math.degrees(radians), 1)
