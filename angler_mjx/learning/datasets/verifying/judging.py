"""All checks of a dataset, one after another."""

from collections.abc import Callable
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.verifying import again, sound
from angler_mjx.learning.datasets.verifying.report import DatasetCheck, VerificationReport


def verify(place: Path, flights: int, tell: Callable[[str, int, int], None]) -> VerificationReport:
    """Judge a dataset.

    Args:
        place: its folder.
        flights: episodes to fly again; they are left out where files or values are wrong.
        tell: told what is looked at, how much of it is done, and how much there is.

    Raises:
        ConfigError: there is no manifest, or it cannot be read.
    """
    found = manifest.read(place)
    steps: list[Callable[[], DatasetCheck]] = [
        lambda: sound.files(place, found),
        lambda: sound.parts(place, found),
        lambda: sound.rows(place, found, index.read(place)),
        lambda: sound.values(place, found),
    ]
    names = ("files", "parts", "index", "values")
    checks: list[DatasetCheck] = []
    for number, (name, step) in enumerate(zip(names, steps, strict=True)):
        tell(name, number, len(steps))
        try:
            checks.append(step())
        except ConfigError as error:
            broken = DatasetCheck(name=name, looked_at="broke off")
            broken.wrong(name, str(error))
            checks.append(broken)
    if flights and not any(check.findings for check in checks):
        checks.append(
            again.fly(place, found, flights, lambda done, of: tell("flying again", done, of))
        )
    else:
        why = "what is stored is damaged" if flights else "--again N flies N episodes again"
        checks.append(
            DatasetCheck(
                name="flown again",
                looked_at=f"not checked: {why}",
                unchecked=found.episodes,
                why=why,
            )
        )
    return VerificationReport(dataset=str(place), checks=tuple(checks))
