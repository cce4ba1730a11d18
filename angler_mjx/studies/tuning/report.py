"""What a tuning leaves: gain files, tables before and after, figures."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from angler_mjx.report.viewing.style import save
from angler_mjx.report.viewing.tables import table
from angler_mjx.studies.flights.measures import Measures
from angler_mjx.studies.tuning import figures, folder, gain_files
from angler_mjx.studies.tuning.outcome import STIFFER, ObjectivePart, TuningOutcome
from angler_mjx.studies.tuning.samples import COURSES

_SHOWN = 20
"""Seeds of flights that failed, at most."""


def write(place: Path, found: TuningOutcome) -> None:
    """Write everything into a folder.

    Raises:
        RunError: the disk gave out.
    """
    problem = found.problem
    comments = provenance_lines(found)
    controller = problem.settings.controller
    stages, gains = problem.spec.stages, found.gains
    folder.write(place / "gains.toml", gain_files.toml(controller, stages, gains, comments))
    if (firmware := gain_files.ardusub(gains)) is not None:
        exist = np.asarray(problem.robots.params.vehicle.thruster_exists)
        outputs = int(exist.sum(axis=1).max())
        for name, written in (
            ("ardusub.param", gain_files.param),
            ("ardusub.params", gain_files.params),
        ):
            folder.write(place / name, written(firmware, outputs, comments))
    folder.write(place / "report.md", text(found))
    for name, draw in figures.ALL.items():
        save(draw(found), place / f"{name}.png", palette=128)


def provenance_lines(found: TuningOutcome) -> list[str]:
    """Where the gains come from, a line each."""
    origin, settings = found.provenance, found.problem.settings
    versions = [f"{name} {number}" for name, number in origin["versions"].items() if number]
    ended = "" if found.complete else " (interrupted)"
    return [
        f"Gains of {settings.controller}, tuned for {settings.objective} on the robots of the "
        f"scenario {settings.scenario.name}.",
        f"Command: {origin['command']}",
        f"Commit: {origin['commit'] or 'unknown'}; Python {origin['python']}, "
        + ", ".join(versions),
        f"Seed {settings.seed}, {settings.rollouts} flights a candidate, method "
        f"{settings.method}, {len(found.history.generations)} of {settings.generations} "
        f"generations{ended}, on {origin['device']}.",
        f"Objective, 1 before: {found.train.cost:.4f} on the flights tuned on, "
        f"{found.held_out.cost:.4f} on others.",
    ]


def text(found: TuningOutcome) -> str:
    """The report."""
    settings = found.problem.settings
    parts = [f"# {settings.controller}, tuned for {settings.objective}"]
    parts += ["\n".join(f"- {line}" for line in provenance_lines(found))]
    if found.problem.robots.left_out:
        parts += [
            "Left out, as nothing holds them level: "
            + "; ".join(found.problem.robots.left_out)
            + "."
        ]
    parts += ["## Objective", _objective(found), "## Gains", _gains(found)]
    parts += [f"![{name}]({name}.png)" for name in figures.ALL]
    for title, part in (("Flights held out", found.held_out), ("Flights tuned on", found.train)):
        parts += [f"## {title}, before → after", _measures(found, part)]
    return "\n\n".join(parts) + "\n"


def _objective(found: TuningOutcome) -> str:
    stiff = found.stiffer
    rows = [
        ["flights tuned on", *_costs(found.train)],
        ["flights held out", *_costs(found.held_out)],
        [f"held out, every tuned gain x {STIFFER:g} after", *_costs(stiff)],
    ]
    head = ["flights", "before", "after", "failed before", "failed after"]
    seeds = [
        f"- {title}: " + ", ".join(map(str, numbers[:_SHOWN])) + ", ..." * (len(numbers) > _SHOWN)
        for title, part in (("tuned on", found.train), ("held out", found.held_out))
        if (numbers := np.flatnonzero(part.after.failed).tolist())
    ]
    lost = "Numbers of the flights that fail after:\n\n" + "\n".join(seeds) if seeds else ""
    return "\n\n".join(
        [
            table(head, rows),
            "What the gains began with is 1; docs/tuning.md has the formulas. The last row tells "
            "how far the gains are from trouble.",
            *([lost] if lost else []),
        ]
    )


def _costs(part: ObjectivePart) -> list[str]:
    failed = [f"{int(np.sum(x.failed))} of {len(x.failed)}" for x in (part.before, part.after)]
    return ["1", f"{part.cost:.3f}", *failed]


def _gains(found: TuningOutcome) -> str:
    rows = []
    for knob, turn in zip(found.problem.knobs, found.turns, strict=True):
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
    return table(["gain", "before", "after", "searched in"], rows)


def _measures(found: TuningOutcome, part: ObjectivePart) -> str:
    columns: list[tuple[str, Callable[[Measures, np.ndarray], str]]] = [
        ("ISE, m² s", lambda m, k: f"{np.mean(m.ise_m2s[k]):.3g}"),
        ("RMS error, cm", lambda m, k: f"{100 * np.sqrt(np.mean(m.rms_m[k] ** 2)):.3g}"),
        ("greatest error of the last 10 s, cm", lambda m, k: f"{100 * np.max(m.end_m[k]):.3g}"),
        ("mean swing, cm", lambda m, k: f"{100 * np.mean(m.swing_m[k]):.2g}"),
        ("jitter, us", lambda m, k: f"{np.mean(m.jitter_us[k]):.2g}"),
        ("energy, J/m", lambda m, k: f"{np.mean(m.energy_jpm[k]):.3g}"),
        ("failed", lambda m, k: f"{int(np.sum(m.failed[k]))}"),
    ]
    rows = []
    for i, label in enumerate(found.problem.robots.labels):
        for j, course in enumerate(COURSES):
            rows_of = np.flatnonzero(part.flights.group == i * len(COURSES) + j)
            cells = [
                f"{show(part.before, rows_of)} → {show(part.after, rows_of)}" for _, show in columns
            ]
            rows.append([f"{label}: {course}", *cells])
    return table(["robot: course", *(name for name, _ in columns)], rows)
