"""Looking whether real autopilots can be run here: one row for each thing that has to be right."""

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
from angler_sitl.firmware.binary import Binary, find
from angler_sitl.wire.ports import allocate, number

_PORTS_OF = 8
"""Vehicles whose ports are tried."""


@dataclass(frozen=True, kw_only=True)
class DoctorCheck:
    """One row.

    Attributes:
        name: What was looked at.
        good: False where it is at fault; None where it is for the reader to judge.
        text: What was found, and what to do about it.
    """

    name: str
    good: bool | None
    text: str


def examine(ardusub: Path | None = None) -> Iterator[DoctorCheck]:
    """Look at everything, a row at a time; what needs a program is left out where there is none.

    Args:
        ardusub: The program, where it is not to be found as `binary.find` does.
    """
    yield _ports()
    try:
        binary = find(ardusub)
    except AnglerError as error:
        yield DoctorCheck(name="binary", good=False, text=str(error))
        return
    size = binary.path.stat().st_size
    yield DoctorCheck(name="binary", good=True, text=f"{binary.path}, {size / 1e6:.1f} MB")
    yield DoctorCheck(name="sha256", good=True, text=binary.sha256)
    for count, name in enumerate(library.available()):
        rows = list(_vehicle(binary, name, first=count == 0))
        yield from rows
        if rows[0].name == "version" and not rows[0].good:
            return


def _ports() -> DoctorCheck:
    try:
        given = allocate(_PORTS_OF)
    except AnglerError as error:
        return DoctorCheck(name="ports", good=False, text=str(error))
    used = sorted(number(bound) for one in given for bound in (one.fdm, one.mavlink, one.vision))
    for one in given:
        one.close()
    text = f"{len(used)} for {_PORTS_OF} robots, for example {used[0]} to {used[-1]}"
    return DoctorCheck(name="ports", good=True, text=text)


def _vehicle(binary: Binary, name: str, *, first: bool) -> Iterator[DoctorCheck]:
    """Boot it as one vehicle; the rows that do not depend on the vehicle come with the first."""
    row = f"parameters, {name}"
    try:
        vehicle = library.load(name)
        airframe.frame_of(vehicle)
    except AnglerError as error:
        yield DoctorCheck(name=row, good=None, text=str(error))
        return
    ours = parameters.for_vehicle(vehicle, "guided", "vision", log=False)
    with tempfile.TemporaryDirectory(prefix="angler_sitl_") as folder:
        try:
            with probe.standing_still(binary, Path(folder), ours) as still:
                said = probe.ask(still)
                open_ = sockets.of(still.instance.pid)
        except AnglerError as error:
            yield DoctorCheck(name="version" if first else row, good=False, text=str(error))
            return
    if first:
        yield DoctorCheck(name="version", good=True, text=f"{said.version} ({said.git})")
        yield _sockets(open_)
    wrong = parameters.differences(ours, said.parameters)
    text = "; ".join(wrong) or f"{len(ours)} set and read back out of {len(said.parameters)}"
    yield DoctorCheck(name=row, good=not wrong, text=text)


def _sockets(found: list[sockets.BoundSocket]) -> DoctorCheck:
    """Those of one autopilot that are not loopback's alone."""
    reachable = [str(one) for one in found if not one.loopback]
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
