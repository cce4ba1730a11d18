"""The tables of docs/control.md, put between its marks."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path

from angler_mjx.report.viewing import tables
from angler_mjx.report.viewing.tables import table
from angler_mjx.studies.flights import kinds, measures
from angler_mjx.studies.flights.samples import CURRENT_MPS, STEP_M
from angler_mjx.studies.trials import eight, samples, steps, trial
from angler_mjx.studies.trials.eight import Eight
from angler_mjx.studies.trials.steps import TrialStep
from angler_mjx.studies.trials.trial import Trial

BEGIN, END = "<!-- trials: begin -->", "<!-- trials: end -->"
_STILL, _CURRENT = steps.CURRENTS_MPS


def text(trials: Sequence[Trial], third_order: Sequence[TrialStep], images: str) -> str:
    """Everything between the marks.

    Args:
        trials: of each controller.
        third_order: steps of the cascade with rotors of third order; empty if not flown.
        images: folder of the figures, as seen from the document.
    """
    parts = ["## In short", _summary(trials)]
    if any(one.verdicts for one in trials):
        parts += ["## Random draws", _draws(trials)]
    if third_order:
        parts += ["## Rotors of third order", _third_order(third_order)]
    for one in trials:
        parts += [f"## {one.controller}", _controller(one, images)]
    return "\n\n".join(parts)


def require_place(document: Path) -> None:
    """Refuse a document that `write` could not write into, before hours of flights.

    Raises:
        ConfigError: as `write`.
    """
    tables.require_place(document, BEGIN, END)


def write(document: Path, body: str) -> None:
    """Put a text between the two marks of a document.

    Raises:
        ConfigError: the document cannot be read or written, or has no marks.
    """
    tables.put(document, BEGIN, body, END)


def _summary(trials: Sequence[Trial]) -> str:
    loose = kinds.loose()

    def of_steps(one: Trial, flow: float) -> str:
        held = [s for s in one.flown.steps if s.kind not in loose and s.current_mps == flow]
        bad = sum(bool(trial.misses_of_step(s)) for s in held)
        worst = f"{_cm(max(s.error_m for s in held))} cm"
        turns = [s.error_rad for s in held if not math.isnan(s.error_rad)]
        if flow == _STILL and turns:
            worst += f", {_degrees(max(turns))}°"
        return worst + (f"; {bad} of {len(held)} miss" if bad else "")

    def of_eights(one: Trial, still: bool) -> str:
        flown = [
            e
            for e in one.eights
            if e.kind not in loose and (e.condition == eight.CONDITIONS[0][0]) == still
        ]
        bad = sum(bool(trial.misses_of_eight(e)) for e in flown)
        worst = f"{_cm(max(e.error_m for e in flown))} cm"
        return worst + (f"; {bad} of {len(flown)} miss" if bad else "")

    rows = [
        [
            f"[{one.controller}](#{one.controller})",
            of_steps(one, _STILL),
            of_steps(one, _CURRENT),
            of_eights(one, True),
            of_eights(one, False),
        ]
        for one in trials
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
        f"\n\n{table(head, rows)}"
    )


def _draws(trials: Sequence[Trial]) -> str:
    rows, faults = [], []
    for one in trials:
        held = [v for v in one.verdicts if v.draw.kind not in kinds.loose()]
        loose = [v for v in one.verdicts if v.draw.kind in kinds.loose()]
        found, other = trial.counts(held), trial.counts(loose)
        rows.append(
            [
                one.controller,
                f"{len(held):,}",
                *(f"{found[name]:,}" for name in ("station", "outrun", "away", "failed")),
                _degrees(max((v.tilt_rad for v in held), default=math.nan)),
                f"{max((v.rate_radps for v in held), default=math.nan):.2f}",
                f"{other['failed']:,} of {len(loose):,}",
            ]
        )
        faults += [
            f"- {one.controller}, seed {v.draw.seed}: {v.draw.kind.label}, {v.fault}"
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
            f"{CURRENT_MPS:g} m/s x every gain {100 * samples.GAIN_SHARE:.0f} % up or down x a "
            f"step of up to {STEP_M:g} m and half a turn; {samples.FLIGHT_S:g} s each. Failed "
            f"is what leans more than {math.degrees(measures.TILT_RAD):.0f} degrees, turns faster "
            f"than {measures.RATE_RADPS:g} rad/s, or still turns faster than "
            f"{samples.QUIET_RADPS:g} rad/s in the last {samples.LAST_S:g} s. On station is within "
            f"{samples.STATION_M:g} m there; outrun is not, in a current above "
            f"{100 * samples.OUTRUN_SHARE:.0f} % of the vehicle's slowest level "
            "terminal speed; away is not, in a slower one.",
            table(head, rows),
            "Failing draws of vehicles that something holds level: "
            + ("\n\n" + "\n".join(faults) if faults else "none."),
            "Seeds of all draws that did not keep station are in "
            "[control_draws.csv](control_draws.csv); `angler control --controller NAME --draw "
            "SEED` flies one again.",
        ]
    )


def _third_order(flown: Sequence[TrialStep]) -> str:
    return (
        "The cascade with rotors that answer as von Benzon et al. 2022 identified them "
        '(`rotor_response = "third_order"`), in place of the lag.\n\n' + _step_table(flown)
    )


def _controller(one: Trial, images: str) -> str:
    return "\n\n".join(
        [
            f"![Step responses and figures of eight]({images}/control_{one.controller}.png)",
            _gains(one.controller),
            _step_table(one.flown.steps),
            _eight_table(one.eights),
        ]
    )


def _gains(controller: str) -> str:
    spec = kinds.spec_of(controller)
    parts = []
    for stage, gains in zip(spec.stages, spec.gains, strict=True):
        numbers = [f"{entry.name} {getattr(gains, entry.name):g}" for entry in fields(gains)]
        if numbers:
            parts.append(f"`{stage.name}`: {', '.join(numbers)}")
    return "Gains. " + "; ".join(parts) + "."


def _step_table(flown: Sequence[TrialStep]) -> str:
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
                _each(_number(s.rise_s, 1) for s in still),
                _each(_number(100 * s.overshoot, 0) for s in still),
                _each(_number(s.settling_s, 1) for s in still),
                _each(_cm(s.error_m) for s in still),
                _each(_degrees(s.error_rad) for s in still),
                _each(_cm(s.error_m) for s in moving),
                _each(_degrees(s.error_rad) for s in moving),
                ", ".join(swings) or "no",
                _degrees(max(s.tilt_rad for s in [*still, *moving])),
            ]
        )
    return (
        "Steps of "
        + " / ".join(dict.fromkeys(s.axis for s in flown))
        + ":\n\n"
        + (table(head, rows))
    )


def _eight_table(flown: Sequence[Eight]) -> str:
    names = [name for name, _, _ in eight.CONDITIONS]
    rows = [
        [
            kind.label,
            *(
                _errors(next(e for e in flown if e.kind == kind and e.condition == name))
                for name in names
            ),
        ]
        for kind in dict.fromkeys(one.kind for one in flown)
    ]
    return "Figure of eight, RMS error in time / across the path, cm:\n\n" + table(
        ["vehicle, set", *names], rows
    )


def _errors(one: Eight) -> str:
    slow = "" if one.speed_mps == eight.SPEED_MPS else f" ({one.speed_mps:g} m/s)"
    return f"{_cm(one.in_time_m)} / {_cm(one.across_m)}{slow}"


def _each(numbers: Iterable[str]) -> str:
    every = list(numbers)
    return "-" if set(every) == {"-"} else " / ".join(every)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _cm(metres: float) -> str:
    """Centimetres to a tenth, below a thousand."""
    return _number(100 * metres, 1) if not metres >= 10 else f"{100 * metres:.0f}"


def _degrees(radians: float) -> str:
    return _number(math.degrees(radians), 1)
