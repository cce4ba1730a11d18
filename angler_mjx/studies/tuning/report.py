"""What a tuning leaves: gain files, tables before and after, figures."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from angler_mjx.report.plotting.style import save_figure
from angler_mjx.report.viewing.markdown_tables import format_table
from angler_mjx.studies.flights.measures import FlightMeasures
from angler_mjx.studies.tuning import figures, folder, gain_files
from angler_mjx.studies.tuning.outcome import STIFFER, ObjectivePart, TuningOutcome
from angler_mjx.studies.tuning.samples import COURSES

_SHOWN = 20
"""Seeds of flights that failed, at most."""


def write_report(building: Path, outcome: TuningOutcome) -> None:
    """Write everything into a folder.

    Raises:
        RunError: the disk gave out.
    """
    problem = outcome.problem
    comments = provenance_lines(outcome)
    controller = problem.settings.controller
    stages, gains = problem.spec.stages, outcome.gains
    folder.write_file(
        building / "gains.toml", gain_files.format_toml(controller, stages, gains, comments)
    )
    if (firmware := gain_files.find_ardusub_gains(gains)) is not None:
        exist = np.asarray(problem.robots.params.vehicle.thruster_exists)
        outputs = int(exist.sum(axis=1).max())
        for name, written in (
            ("ardusub.param", gain_files.format_param_file),
            ("ardusub.params", gain_files.format_params_file),
        ):
            folder.write_file(building / name, written(firmware, outputs, comments))
    folder.write_file(building / "report.md", format_report(outcome))
    for name, plot in figures.FIGURES.items():
        save_figure(plot(outcome), building / f"{name}.png", palette=128)


def provenance_lines(outcome: TuningOutcome) -> list[str]:
    """Where the gains come from, a line each."""
    origin, settings = outcome.provenance, outcome.problem.settings
    versions = [f"{name} {number}" for name, number in origin["versions"].items() if number]
    ended = "" if outcome.complete else " (interrupted)"
    return [
        f"Gains of {settings.controller}, tuned for {settings.objective} on the robots of the "
        f"scenario {settings.scenario.name}.",
        f"Command: {origin['command']}",
        f"Commit: {origin['commit'] or 'unknown'}; Python {origin['python']}, "
        + ", ".join(versions),
        f"Seed {settings.seed}, {settings.rollouts} flights a candidate, method "
        f"{settings.method}, {len(outcome.history.generations)} of {settings.generations} "
        f"generations{ended}, on {origin['device']}.",
        f"Objective, 1 before: {outcome.train.cost:.4f} on the flights tuned on, "
        f"{outcome.held_out.cost:.4f} on others.",
    ]


def format_report(outcome: TuningOutcome) -> str:
    """The report."""
    settings = outcome.problem.settings
    parts = [f"# {settings.controller}, tuned for {settings.objective}"]
    parts += ["\n".join(f"- {line}" for line in provenance_lines(outcome))]
    if outcome.problem.robots.left_out:
        parts += [
            "Left out, as nothing holds them level: "
            + "; ".join(outcome.problem.robots.left_out)
            + "."
        ]
    parts += ["## Objective", _format_objective(outcome), "## Gains", _format_gains(outcome)]
    parts += [f"![{name}]({name}.png)" for name in figures.FIGURES]
    for title, part in (
        ("Flights held out", outcome.held_out),
        ("Flights tuned on", outcome.train),
    ):
        parts += [f"## {title}, before → after", _format_measures(outcome, part)]
    return "\n\n".join(parts) + "\n"


def _format_objective(outcome: TuningOutcome) -> str:
    stiff = outcome.stiffer
    rows = [
        ["flights tuned on", *_format_costs(outcome.train)],
        ["flights held out", *_format_costs(outcome.held_out)],
        [f"held out, every tuned gain x {STIFFER:g} after", *_format_costs(stiff)],
    ]
    head = ["flights", "before", "after", "failed before", "failed after"]
    seeds = [
        f"- {title}: " + ", ".join(map(str, numbers[:_SHOWN])) + ", ..." * (len(numbers) > _SHOWN)
        for title, part in (("tuned on", outcome.train), ("held out", outcome.held_out))
        if (numbers := np.flatnonzero(part.after.failed).tolist())
    ]
    lost = "Numbers of the flights that fail after:\n\n" + "\n".join(seeds) if seeds else ""
    return "\n\n".join(
        [
            format_table(head, rows),
            "What the gains began with is 1; docs/how_to/tuning.md has the formulas. The last row "
            "tells how far the gains are from trouble.",
            *([lost] if lost else []),
        ]
    )


def _format_costs(part: ObjectivePart) -> list[str]:
    failed = [f"{int(np.sum(x.failed))} of {len(x.failed)}" for x in (part.before, part.after)]
    return ["1", f"{part.cost:.3f}", *failed]


def _format_gains(outcome: TuningOutcome) -> str:
    rows = []
    for knob, turn in zip(outcome.problem.knobs, outcome.turns, strict=True):
        ends = {"least": knob.low, "most": knob.high}
        at = [f" (at the {name} allowed)" for name, end in ends.items() if abs(turn - end) < 1e-3]
        for i, (name, value) in enumerate(zip(knob.gains, knob.values(turn), strict=True)):
            low, high = (knob.start[i] * np.exp(end) for end in ends.values())
            rows.append(
                [
                    f"{knob.stage}.{name}",
                    f"{knob.start[i]:g}",
                    f"{value:g}{''.join(at)}",
                    f"{low:.3g} to {high:.3g}",
                ]
            )
    return format_table(["gain", "before", "after", "searched in"], rows)


def _format_measures(outcome: TuningOutcome, part: ObjectivePart) -> str:
    columns: list[tuple[str, Callable[[FlightMeasures, np.ndarray], str]]] = [
        ("ISE, m² s", lambda m, k: f"{np.mean(m.ise_m2s[k]):.3g}"),
        ("RMS error, cm", lambda m, k: f"{100 * np.sqrt(np.mean(m.rms_m[k] ** 2)):.3g}"),
        ("greatest error of the last 10 s, cm", lambda m, k: f"{100 * np.max(m.end_m[k]):.3g}"),
        ("mean swing, cm", lambda m, k: f"{100 * np.mean(m.swing_m[k]):.2g}"),
        ("jitter, us", lambda m, k: f"{np.mean(m.jitter_us[k]):.2g}"),
        ("energy, J/m", lambda m, k: f"{np.mean(m.energy_jpm[k]):.3g}"),
        ("failed", lambda m, k: f"{int(np.sum(m.failed[k]))}"),
    ]
    rows = []
    for i, label in enumerate(outcome.problem.robots.labels):
        for j, course in enumerate(COURSES):
            rows_of = np.flatnonzero(part.flights.group == i * len(COURSES) + j)
            cells = [
                f"{show(part.before, rows_of)} → {show(part.after, rows_of)}" for _, show in columns
            ]
            rows.append([f"{label}: {course}", *cells])
    return format_table(["robot: course", *(name for name, _ in columns)], rows)
