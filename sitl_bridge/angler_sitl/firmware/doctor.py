"""Checks of the requirements of real autopilots on this machine, one row each."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import AnglerError
from angler_mjx.robot.vehicles import library
from angler_sitl.firmware import (
    airframe,
    parameters,
    probe,
    sockets,
)
from angler_sitl.firmware.binary import Binary, find_binary
from angler_sitl.wire.ports import allocate_ports, port_number

_N_VEHICLES = 8
"""Number of vehicles in the port check."""


@dataclass(frozen=True, kw_only=True)
class DoctorCheck:
    """One row.

    Attributes:
        name: Subject of the check.
        good: False for a fault; None where the reader has to judge.
        text: Result, and the remedy.
    """

    name: str
    good: bool | None
    text: str


def run_checks(ardusub: Path | None = None) -> Iterator[DoctorCheck]:
    """Run all checks, row by row; those that need a program are left out where there is none.

    Args:
        ardusub: The program, where `binary.find_binary` does not find it.
    """
    yield _check_ports()
    try:
        binary = find_binary(ardusub)
    except AnglerError as error:
        yield DoctorCheck(name="binary", good=False, text=str(error))
        return
    size = binary.path.stat().st_size
    yield DoctorCheck(name="binary", good=True, text=f"{binary.path}, {size / 1e6:.1f} MB")
    yield DoctorCheck(name="sha256", good=True, text=binary.sha256)
    for count, name in enumerate(library.list_rovs()):
        rows = list(_check_vehicle(binary, name, first=count == 0))
        yield from rows
        if rows[0].name == "version" and not rows[0].good:
            return


def _check_ports() -> DoctorCheck:
    try:
        allocated = allocate_ports(_N_VEHICLES)
    except AnglerError as error:
        return DoctorCheck(name="ports", good=False, text=str(error))
    numbers = sorted(
        port_number(bound)
        for ports in allocated
        for bound in (ports.fdm, ports.mavlink, ports.vision)
    )
    for ports in allocated:
        ports.close()
    text = f"{len(numbers)} for {_N_VEHICLES} robots, for example {numbers[0]} to {numbers[-1]}"
    return DoctorCheck(name="ports", good=True, text=text)


def _check_vehicle(binary: Binary, name: str, *, first: bool) -> Iterator[DoctorCheck]:
    """Boot the program as one vehicle; general rows come with the first."""
    row_name = f"parameters, {name}"
    try:
        vehicle = library.load_vehicle(name)
        airframe.find_frame(vehicle)
    except AnglerError as error:
        yield DoctorCheck(name=row_name, good=None, text=str(error))
        return
    expected = parameters.for_vehicle(vehicle, "guided", "vision", log=False)
    with tempfile.TemporaryDirectory(prefix="angler_sitl_") as folder:
        try:
            with probe.start_stationary(binary, Path(folder), expected) as autopilot:
                findings = probe.query_autopilot(autopilot)
                open_sockets = sockets.list_sockets(autopilot.instance.pid)
        except AnglerError as error:
            yield DoctorCheck(name="version" if first else row_name, good=False, text=str(error))
            return
    if first:
        yield DoctorCheck(name="version", good=True, text=f"{findings.version} ({findings.git})")
        yield _check_sockets(open_sockets)
    differences = parameters.find_differences(expected, findings.parameters)
    text = (
        "; ".join(differences)
        or f"{len(expected)} set and read back out of {len(findings.parameters)}"
    )
    yield DoctorCheck(name=row_name, good=not differences, text=text)


def _check_sockets(open_sockets: list[sockets.BoundSocket]) -> DoctorCheck:
    """Check an autopilot's sockets for any not limited to loopback."""
    reachable = [str(entry) for entry in open_sockets if not entry.is_loopback]
    if not reachable:
        return DoctorCheck(name="open sockets", good=True, text="none but on loopback")
    if _only_loopback():
        text = f"{', '.join(reachable)}: in a network namespace where there is only loopback"
        return DoctorCheck(name="open sockets", good=True, text=text)
    text = (
        f"{', '.join(reachable)}: other machines can reach this one, ArduSub has no option against "
        "it; --isolate shuts it, or a firewall"
    )
    return DoctorCheck(name="open sockets", good=None, text=text)


def _only_loopback() -> bool:
    lines = Path("/proc/self/net/dev").read_text().splitlines()[2:]
    return all(line.split(":")[0].strip() == "lo" for line in lines)
