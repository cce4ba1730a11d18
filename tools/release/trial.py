"""Trial of a release without the checkout: a new environment, pip, the README's commands."""

import json
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.release.processes import (
    FinishedProcess,
    ReleaseError,
    make_environment,
    run_process,
)

MORE_COMMANDS = (
    "angler leaderboard problems --sets open-still-01 --out problems",
    "angler doctor",
    "angler scenarios show carry_pipe",
    "angler vehicle show bluerov2_heavy",
)
"""Commands beside those of the README: they read files that the wheel ships."""
AN_EXTRA = "angler-mjx[tune]"
"""What pages print to install an extra: the installed wheel has to do for it. It is only resolved,
so that the bill of materials lists none of it."""


@dataclass(frozen=True, kw_only=True)
class TrialStep:
    """Command of a trial as a stranger types it, and what it took."""

    command: str
    finished: FinishedProcess


def read_first_commands(readme: str) -> list[str]:
    """Return the `angler` lines of the first block of a README's section Install.

    Args:
        readme: text of the README.

    Raises:
        ReleaseError: there is none.
    """
    block = re.search(r"^## Install$.*?^```sh\n(.*?)^```", readme, re.MULTILINE | re.DOTALL)
    lines = block[1].splitlines() if block else []
    commands = [line.partition("#")[0].strip() for line in lines if line.startswith("angler ")]
    if not commands:
        raise ReleaseError("README.md: no line `angler ...` in the first block of Install")
    return commands


def try_release(
    folder: Path,
    files: Mapping[str, Path],
    constraints: Path,
    readme: str,
    version: str,
    environment: Mapping[str, str],
    python: Path,
    report: Callable[[TrialStep], None],
) -> Path:
    """Install the wheels as a stranger does, and run what the README prints.

    Args:
        folder: folder outside of the checkout, which is filled.
        files: wheels by the name of their distribution.
        constraints: exact versions of dependencies.
        readme: text of the README.
        version: version that the command has to name.
        environment: variables, none of the checkout.
        python: interpreter to try.
        report: receives each step when it has ended: pip, the README's commands,
            others, an extra, the second wheel.

    Returns:
        The interpreter of the new environment.

    Raises:
        ReleaseError: a step failed, or something comes from elsewhere than the environment.
    """
    work = folder / "work"
    work.mkdir(parents=True)
    programs = make_environment(folder / "venv", environment, python)
    inside = {**environment, "PATH": f"{programs}:{environment['PATH']}"}

    def take(line: str, words: Sequence[str | Path] | None = None) -> None:
        done = run_process(words or shlex.split(line), work, inside)
        report(TrialStep(command=line, finished=done))

    pip: list[str | Path] = [programs / "pip", "install", "--quiet"]
    wheel, second = files["angler_mjx"], files["angler_experiments"]
    take(f"pip install {wheel.name} -c constraints.txt", [*pip, wheel, "-c", constraints])
    for command in read_first_commands(readme):
        take(command)
    for command in MORE_COMMANDS:
        take(command)
    resolve = [*pip, "--dry-run", AN_EXTRA, "-c", constraints]
    take(f"pip install --dry-run '{AN_EXTRA}'", resolve)
    take(f"pip install {second.name}", [*pip, second, "-c", constraints])
    _judge_installed(programs / "python", version, work, inside)
    return programs / "python"


def _judge_installed(
    python: Path, version: str, work: Path, environment: Mapping[str, str]
) -> None:
    """Refuse modules from elsewhere, another version, or planners that do not load."""
    script = (
        "import json, sys, importlib.metadata as m\n"
        "import angler_mjx, angler_kernels, angler_sitl, angler_experiments\n"
        "modules = angler_mjx, angler_kernels, angler_sitl, angler_experiments\n"
        "(learned,) = m.entry_points(group='angler_mjx.planners', name='learned')\n"
        "print(json.dumps({'files': [x.__file__ for x in modules], 'prefix': sys.prefix,"
        " 'versions': [angler_mjx.__version__, *map(m.version, ('angler-mjx',"
        " 'angler-experiments'))], 'planner': learned.load().__name__}))"
    )
    found = json.loads(run_process([python, "-c", script], work, environment).output)
    foreign = [name for name in found["files"] if not name.startswith(found["prefix"] + "/")]
    if foreign:
        raise ReleaseError(f"imported from outside of the new environment: {', '.join(foreign)}")
    if set(found["versions"]) != {version}:
        raise ReleaseError(f"installed versions {found['versions']}, not {version}")


def write_bill_of_materials(
    python: Path, tool: Path, out: Path, environment: Mapping[str, str]
) -> None:
    """List all that a trial installed in CycloneDX 1.6, without addresses of local files.

    Args:
        python: interpreter of the environment that is listed.
        tool: program `cyclonedx-py`.
        out: file to write.
        environment: variables of the process.

    Raises:
        ReleaseError: the program failed, or does not list the wheels.
    """
    words: list[str | Path] = [
        tool,
        "environment",
        "--spec-version",
        "1.6",
        "--output-reproducible",
        python,
    ]
    bill = json.loads(run_process(words, out.parent, environment).output)
    for component in bill["components"]:
        references = component.get("externalReferences", [])
        kept = [one for one in references if not one["url"].startswith("file:")]
        component["externalReferences"] = kept
    names = {component["name"] for component in bill["components"]}
    missing = {"angler-mjx", "angler-experiments", "jax", "mujoco"} - names
    if missing:
        raise ReleaseError(f"{out.name} does not list {', '.join(sorted(missing))}")
    out.write_text(json.dumps(bill, indent=1, sort_keys=True) + "\n", encoding="utf-8")
