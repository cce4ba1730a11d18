"""`angler sitl`: installation and checks of real ArduSub processes."""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import tyro

from angler_mjx.errors import ConfigError, UnsupportedError

type CommandLevel = Literal["thrusters", "guided", "poshold", "althold", "manual"]
type PositionSource = Literal["vision", "vicon", "gps"]


def install_ardusub(
    from_: Annotated[Path | None, tyro.conf.arg(name="from")] = None,
    url: str | None = None,
    version: str = "stable-4.5.3",
    sha256: str | None = None,
) -> None:
    """Install an ArduSub SITL into the cache folder, where all commands look for it.

    It is downloaded from ArduPilot's server, or taken from a file without a network. An interrupted
    download continues when the command is run again.

    Args:
        from_: Install this file, without a network.
        url: Download from this address instead of ArduPilot's server.
        version: Official build: stable-4.5.3, latest, ...
        sha256: Expected checksum; refuse any other file.
    """
    require_pymavlink()
    if from_ is not None and url is not None:
        raise ConfigError("--from and --url: give one of them")
    from angler_sitl.firmware import install as installing

    if from_ is not None:
        installed = installing.install_from_file(from_.expanduser(), checksum=sha256)
    else:
        with _TransferBar() as bar:
            installed = installing.install_from_network(
                version, url, bar.update_progress, checksum=sha256
            )
    print(f"ArduSub {installed.version}, sha256 {installed.sha256}", file=sys.stderr)
    print(installed.path)


def run_doctor(ardusub: Path | None = None, isolate: bool = False) -> None:
    """Check whether real autopilots can run here, and print the results in a table.

    Args:
        ardusub: ArduSub binary to check; if left out, that of ANGLER_ARDUSUB, else the installed
            one.
        isolate: Run in a network namespace, where no socket can be reached from outside.
    """
    require_pymavlink()
    if isolate:
        from angler_sitl.firmware import isolation

        isolation.isolate_network()
    from rich.console import Console

    from angler_mjx.cli.shared.consoles import make_progress_console
    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_sitl.firmware.doctor import run_checks

    table = text_table("", "looked at", "found")
    marks = {True: "[green]good", False: "[red]fault", None: "[yellow]note"}
    faults = []
    with make_progress_console().status("looking"):
        for check in run_checks(ardusub):
            table.add_row(marks[check.good], check.name, check.text)
            if check.good is False:
                faults.append(check.name)
    Console().print(table)
    if faults:
        raise ConfigError(f"at fault: {', '.join(faults)}; see the table")


def write_parameters(
    out: Path,
    vehicle: str = "bluerov2_heavy",
    parameters: Path | None = None,
    level: CommandLevel = "guided",
    source: PositionSource = "vision",
    ardusub: Path | None = None,
    force: bool = False,
) -> None:
    """Boot an ArduSub with the parameters of a vehicle, and write all of its parameters.

    Args:
        out: File to write: .params for QGroundControl, else as Mission Planner and MAVProxy load it
            (.param, .parm).
        vehicle: Name of a shipped vehicle, or path of a vehicle file.
        parameters: File with further parameters, of any of these programs.
        level: Command level, as for angler sitl run.
        source: Source of ArduSub's position.
        ardusub: ArduSub binary; if left out, that of ANGLER_ARDUSUB, else the installed one.
        force: Replace an older file.
    """
    require_pymavlink()
    import tempfile

    from angler_mjx.robot.vehicles.library import load_vehicle
    from angler_mjx.runs.storage.atomic_files import replace_file
    from angler_sitl.firmware import binary, probe
    from angler_sitl.firmware import parameters as firmware

    wanted = firmware.for_vehicle(load_vehicle(vehicle), level, source)
    if parameters is not None:
        wanted |= firmware.read_parameters(parameters)
    with replace_file(out, flag="--out", force=force) as writing:
        with (
            tempfile.TemporaryDirectory(prefix="angler_sitl_") as folder,
            probe.start_stationary(binary.find_binary(ardusub), Path(folder), wanted) as autopilot,
        ):
            result = probe.query_autopilot(autopilot)
        for difference in firmware.find_differences(wanted, result.parameters):
            print(difference, file=sys.stderr)
        text = firmware.format_parameters(
            result.parameters,
            "params" if out.suffix == ".params" else "param",
            types=result.parameter_types,
            sysid=result.sysid,
            version=result.version,
        )
        writing.write_text(text, encoding="utf-8")
    print(f"{len(result.parameters)} parameters of ArduSub {result.version}", file=sys.stderr)
    print(out)


def require_pymavlink() -> None:
    """Refuse to continue without pymavlink.

    Raises:
        UnsupportedError: it is not installed.
    """
    if find_spec("pymavlink") is None:
        raise UnsupportedError("real autopilots need pymavlink: pip install 'angler-mjx[sitl]'")


class _TransferBar:
    """Progress of a download on stderr."""

    def __init__(self) -> None:
        from rich.progress import BarColumn, DownloadColumn, Progress, TransferSpeedColumn

        from angler_mjx.cli.shared.consoles import make_progress_console

        self._bar = Progress(
            BarColumn(), DownloadColumn(), TransferSpeedColumn(), console=make_progress_console()
        )
        self._task = self._bar.add_task("ardusub", total=None)

    def __enter__(self) -> "_TransferBar":
        self._bar.start()
        return self

    def __exit__(self, *ended: object) -> None:
        self._bar.stop()

    def update_progress(self, done: int, total: int | None) -> None:
        """See `angler_sitl.firmware.download.TransferProgress`."""
        self._bar.update(self._task, completed=done, total=total)
