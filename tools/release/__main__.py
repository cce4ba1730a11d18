"""``python -m tools.release``: make a release from a clean checkout, judge it, and try it."""

import hashlib
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from tools.release import contents, trial, versions
from tools.release.building import build_distributions, export_commit
from tools.release.processes import (
    ReleaseError,
    clean_environment,
    make_environment,
    run_process,
)

ROOT = Path(__file__).resolve().parents[2]
REQUIREMENTS = Path(__file__).with_name("requirements.txt")
CONSTRAINTS, BILL, SUMS = "constraints.txt", "sbom.cdx.json", "SHA256SUMS"
COPIED = (CONSTRAINTS, "Containerfile")
"""Files of the commit that a release holds beside what is built."""


@dataclass(frozen=True, kw_only=True)
class ReleaseOptions:
    """Build both wheels and the source distribution from the commit, judge them and try them.

    Refuses a checkout with changes, and a version that files do not agree on. Nothing is uploaded.
    """

    out: Path = ROOT / "dist"
    """Folder of the release; its former contents are removed."""
    check: bool = False
    """Judge the checkout alone; build nothing."""
    trial: bool = True
    """Install the wheels in a new environment and run the README's commands there. A release that
    was not tried has no bill of materials."""


def main(options: ReleaseOptions) -> int:
    """Make the release; return the exit code: 1 for a fault, 0 otherwise."""
    try:
        version = versions.read_version(ROOT)
        if faults := versions.find_version_faults(ROOT):
            raise ReleaseError("\n".join(faults))
        commit, seconds = versions.read_commit(ROOT, version)
        print(f"release: {version}, commit {commit[:8]}", flush=True)
        if not options.check:
            with tempfile.TemporaryDirectory(prefix="release-") as made:
                make_release(options, Path(made).resolve(), version, commit, seconds)
    except ReleaseError as error:
        for line in str(error).splitlines():
            print(f"release: {line}", file=sys.stderr)
        return 1
    for file in versions.find_owner_fields(ROOT):
        print(f"release: left to the owners: fields of {file}")
    return 0


def make_release(
    options: ReleaseOptions, made: Path, version: str, commit: str, seconds: int
) -> None:
    """Build, judge and try a release in a new folder, then copy it to where it belongs.

    Args:
        options: of the command.
        made: new folder outside of the checkout.
        version: version to release.
        commit: commit to release.
        seconds: its time [s since 1970], which all files in archives get.

    Raises:
        ReleaseError: a step failed.
    """
    start = time.monotonic()
    environment = clean_environment(made / "home", {"SOURCE_DATE_EPOCH": str(seconds)})
    python = Path(sys.base_prefix) / "bin" / Path(sys.executable).resolve().name
    programs = make_environment(made / "tools", environment, python)
    run_process([programs / "pip", "install", "--quiet", "-r", REQUIREMENTS], made, environment)
    source = export_commit(ROOT, commit, made / "source")
    files = build_distributions(source, made / "dist", programs / "python", environment)
    _judge_files(files, commit, programs / "twine", made, environment)
    print(f"release: built and judged, {time.monotonic() - start:.0f} s", flush=True)
    for name in COPIED:
        shutil.copy(source / name, made / "dist")
    if options.trial:
        fresh = clean_environment(made / "stranger")
        tried = trial.try_release(
            made / "trial",
            files,
            made / "dist" / CONSTRAINTS,
            (source / "README.md").read_text(encoding="utf-8"),
            version,
            fresh,
            python,
            _print_step,
        )
        bill = made / "dist" / BILL
        trial.write_bill_of_materials(tried, programs / "cyclonedx-py", bill, environment)
        if str(made) in bill.read_text(encoding="utf-8"):
            raise ReleaseError(f"{BILL}: names {made}, a path of a machine")
    _write_sums(made / "dist")
    shutil.rmtree(options.out, ignore_errors=True)
    shutil.copytree(made / "dist", options.out)
    for path in sorted(options.out.iterdir()):
        print(f"release: {path.stat().st_size:>10,} bytes  {path}")


def _print_step(step: trial.TrialStep) -> None:
    done = step.finished
    times = f"{done.seconds:6.1f} s, {done.cpu_seconds:6.1f} s of processors"
    print(f"release: {times}  {step.command}", flush=True)


def _judge_files(
    files: dict[str, Path], commit: str, twine: Path, made: Path, environment: dict[str, str]
) -> None:
    """Refuse files whose metadata or contents are not those of a release."""
    run_process([twine, "check", "--strict", *files.values()], made, environment)
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-tree", "-r", "-z", "--name-only", commit],
        capture_output=True,
        text=True,
        check=True,
    )
    tracked = [name for name in listed.stdout.split("\0") if name]
    paths = [str(made), f"{ROOT}/", *([f"{Path.home()}/"] if Path.home() != Path("/") else [])]
    faults = []
    for kind, path in files.items():
        held = contents.find_content_faults(
            contents.read_members(path), paths=paths, tracked=tracked if kind == "sdist" else None
        )
        faults += [f"{path.name}: {fault}" for fault in held] + contents.find_size_fault(path)
    if faults:
        raise ReleaseError("\n".join(faults))


def _write_sums(folder: Path) -> None:
    """Write the SHA-256 of each file, as `sha256sum -c` reads them."""
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n"
        for path in sorted(folder.iterdir())
        if path.name != SUMS
    ]
    (folder / SUMS).write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(tyro.cli(ReleaseOptions)))
