"""Addresses of vehicles: a connection string and a system number for each robot."""

from collections.abc import Sequence
from dataclasses import dataclass

from angler_mjx.errors import ConfigError
from angler_sitl.wire.endpoint import EndpointAddress, parse_endpoint


@dataclass(frozen=True, kw_only=True)
class VehicleAddress:
    """Where a vehicle is reached."""

    endpoint: EndpointAddress
    sysid: int


def list_addresses(
    endpoints: Sequence[str], sysids: Sequence[int], robots: int
) -> list[VehicleAddress]:
    """Return the address of each robot.

    Args:
        endpoints: connection strings: one for each robot, or one for all of them.
        sysids: system number of each robot; if left out, 1 of a robot with an endpoint of its
            own, and 1, 2, ... on an endpoint of all.
        robots: number of robots.

    Raises:
        ConfigError: another number of endpoints or system numbers, or one twice.
    """
    if len(endpoints) not in (1, robots):
        raise ConfigError(
            f"--endpoint: {len(endpoints)} endpoints for {robots} robots; give one for each, or "
            "one for all"
        )
    if sysids and len(sysids) != robots:
        raise ConfigError(f"--system-id: {len(sysids)} numbers for {robots} robots; give one each")
    if wrong := [number for number in sysids if not 1 <= number <= 254]:
        raise ConfigError(f"--system-id {wrong[0]}: give a number from 1 to 254")
    is_common = len(endpoints) == 1
    numbers = list(sysids) or (list(range(1, robots + 1)) if is_common else [1] * robots)
    parsed = [
        parse_endpoint(text) for text in (list(endpoints) * robots if is_common else endpoints)
    ]
    addresses = [
        VehicleAddress(endpoint=endpoint, sysid=sysid)
        for endpoint, sysid in zip(parsed, numbers, strict=True)
    ]
    for i, address in enumerate(addresses):
        if address in addresses[:i]:
            raise ConfigError(
                f"--endpoint {address.endpoint.text}: system {address.sysid} is there twice; "
                "number the robots with --system-id"
            )
    return addresses
