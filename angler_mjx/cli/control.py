"""`angler control`: trials of the controllers, as tables, figures and seeds."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from angler_mjx.cli.shared.device import Device, choose_device
from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from rich.console import Console


def control(
    controller: tuple[str, ...] = (),
    samples: int = 0,
    sample: int | None = None,
    out: Path | None = None,
    device: Device | None = None,
) -> None:
    """Fly the trials of the controllers: steps, a figure of eight, random samples.

    Every shipped vehicle flies with every parameter set, in open water, with its true state known.

    Args:
        controller: Controllers by name, as in --controller cascade tracking; all if left out.
        samples: Number of random samples of each controller (vehicle, battery, current, gains),
            with seeds from 0; 10000 take about a minute per controller on two cores.
        sample: Fly the sample of this seed alone and print its result.
        out: Document whose tables are replaced; figures go to images/ and seeds to
            control_draws.csv beside it. Printed only if left out.
        device: Device to compute on; JAX's choice if left out.
    """
    if samples < 0 or (sample is not None and sample < 0):
        raise ConfigError("--samples, --sample: give 0 or more")
    choose_device(device)
    from angler_mjx.robot.control.stages import CONTROLLERS
    from angler_mjx.studies.flights import kinds

    names = controller or tuple(CONTROLLERS)
    for name in names:
        kinds.spec_of(name)
    if sample is not None:
        _fly_samples(names, sample)
    else:
        _fly_trials(names, samples, out)


def _fly_samples(names: Sequence[str], seed: int) -> None:
    from angler_mjx.studies.trials import sample_report, samples

    for name in names:
        (verdict,) = samples.fly_samples(name, [seed])
        print(sample_report.format_verdict(name, verdict))


def _fly_trials(names: Sequence[str], n_samples: int, out: Path | None) -> None:
    from rich.console import Console

    from angler_mjx.report.plotting import style
    from angler_mjx.studies.flights import kinds
    from angler_mjx.studies.trials import document, figures, sample_report, steps, trial

    if out is not None:
        document.require_marks(out)
    vehicles = kinds.shipped_vehicles()
    console = Console(stderr=True)
    trials = []
    for name in names:
        console.print(f"{name} ...", style="dim")
        with _progress_bar(console, n_samples) as advance:
            trials.append(trial.fly_trials(name, vehicles, n_samples, advance))
    third_order_steps: tuple[steps.TrialStep, ...] = ()
    if "cascade" in names:
        console.print("cascade with rotors of third order ...", style="dim")
        third_order_steps = steps.fly_steps("cascade", vehicles, "third_order").steps
    body = document.format_document(trials, third_order_steps, "images")
    if out is None:
        print(body)
        return
    document.write_document(out, body)
    if n_samples:
        sample_report.write_samples(out.parent / "control_draws.csv", trials)
    for result in trials:
        style.save_figure(
            figures.plot_trial(result),
            out.parent / "images" / f"control_{result.controller}.png",
            palette=128,
        )
    print(out)


@contextmanager
def _progress_bar(console: "Console", n_samples: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar of samples; yields a function of the number just done."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as display:
        task = display.add_task("samples", total=n_samples, visible=n_samples > 0)
        yield lambda count: display.advance(task, count)
