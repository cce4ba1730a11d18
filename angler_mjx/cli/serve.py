"""`angler serve`: topics, services and actions of one world, for programs outside."""

import sys
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.cli.sitl.commands import CommandLevel, PositionSource
from angler_mjx.cli.sitl.run import build_opener as real_autopilots
from angler_mjx.cli.sitl.run import require_sitl
from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.serve.backends.interface import Backend
    from angler_mjx.serve.door import DoorResult
    from angler_sitl.endpoints.session import EndpointSettings

type BackendName = Literal["auto", "rclpy", "zenoh", "none"]

type EndAction = Literal["hold", "surface", "disarm"]

LOOPBACK = "127.0.0.1"


def serve(
    scenario: Annotated[str, tyro.conf.Positional],
    backend: BackendName = "auto",
    foxglove: bool = False,
    pace: str = "real",
    control_dt_s: float | None = None,
    address: str = LOOPBACK,
    port: int = 7447,
    foxglove_port: int = 8765,
    world: int = 0,
    seed: int | None = None,
    out: Path | None = None,
    duration: float | None = None,
    silence: float = 0.5,
    level: CommandLevel | None = None,
    source: PositionSource | None = None,
    ardusub: Path | None = None,
    endpoint: tuple[str, ...] = (),
    system_id: tuple[int, ...] = (),
    arm: bool = False,
    follow_plans: bool = False,
    max_speed: float | None = None,
    fence: str | None = None,
    at_end: EndAction | None = None,
    link_timeout: float | None = None,
    position_timeout: float | None = None,
    origin: str | None = None,
    device: Device = "cpu",
) -> None:
    """Serve one world to ROS 2, Zenoh and Foxglove until Ctrl-C: topics, services, actions.

    Robots follow their plans until they receive commands.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        backend: rclpy: a node of ROS 2; zenoh: a router of Zenoh with the keys of rmw_zenoh_cpp;
            auto: rclpy where it can be imported, else zenoh; none: only --foxglove.
        foxglove: Serve a WebSocket for Foxglove too.
        pace: real, a multiple of real time as in 2.5, max, or step: clients call the service
            /step.
        control_dt_s: Control period, and so that of messages; the scenario's if left out. 0.02
            gives 50 Hz.
        address: Address to listen at. Any other than that of loopback can be reached from outside,
            and everybody there can command the robots.
        port: Port of Zenoh.
        foxglove_port: Port of the WebSocket.
        world: Index of the world.
        seed: Seed of the run; the scenario's if left out.
        out: Run folder to make, for figures, replays and exports; such a session cannot be reset.
        duration: Seconds of the scene to serve; until Ctrl-C if left out.
        silence: Seconds of the scene without cmd_vel after which a robot driven by it stops.
        level: Real ArduSub steers the robots, and commands enter at this level: thrusters, guided,
            poshold, althold or manual. Without it, robots are simulated as a whole.
        source: With --level, the source of ArduSub's position; vision if left out.
        ardusub: With --level, the ArduSub binary; if left out, that of ANGLER_ARDUSUB, else the
            installed one.
        endpoint: Vehicles that run already, by MAVLink connection strings as those of MAVProxy's
            --master: udp:HOST:PORT listens; udpout:HOST:PORT, tcp:HOST:PORT, /dev/NAME,BAUD. One
            for each robot, or one for all.
        system_id: With --endpoint, MAVLink system number of each robot; 1 if left out, and 1, 2,
            ... where one endpoint is for all.
        arm: With --endpoint, arm the vehicles in GUIDED, once you have typed arm.
        follow_plans: With --arm, robots go to their plans at once; else they stay until they
            receive commands.
        max_speed: With --endpoint, max speed of targets in m/s; 0.3 if left out.
        fence: With --endpoint, box that targets stay in, XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX in m; that
            of the world if left out.
        at_end: With --endpoint, what vehicles are commanded at the end, and after a loss of link or
            position: hold (POSHOLD, or ALT_HOLD without a position), surface, or disarm; hold if
            left out.
        link_timeout: With --endpoint, seconds without messages after which the link is lost; 2 if
            left out.
        position_timeout: With --endpoint, seconds without a good position after which it is lost;
            1 if left out.
        origin: With --endpoint, latitude and longitude of the origin of the world; that of the
            first vehicle's filter if left out.
        device: Device to compute on.
    """
    of_vehicles = {
        "system-id": system_id or None,
        "arm": arm or None,
        "follow-plans": follow_plans or None,
        "max-speed": max_speed,
        "fence": fence,
        "at-end": at_end,
        "link-timeout": link_timeout,
        "position-timeout": position_timeout,
        "origin": origin,
    }
    _check_vehicle_flags(endpoint, of_vehicles, level=level, pace=pace)
    if level is None and (source is not None or ardusub is not None):
        flag = "source" if source is not None else "ardusub"
        raise ConfigError(f"--{flag}: only real autopilots have that; add --level")
    if level is not None or endpoint:
        require_sitl(isolate=False, gcs=None)
    openers = _list_openers(backend, foxglove, address, port, foxglove_port)
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.inputs import build_scenario
    from angler_mjx.serve import serving
    from angler_mjx.teleop import opening

    settings = serving.ServeSettings(
        pace=serving.parse_pace(pace),
        world=world,
        silence_s=silence,
        duration_s=duration,
        out=out,
    )
    times = None if control_dt_s is None else {"control_dt_s": control_dt_s}
    loaded = build_scenario(scenario, seed=seed, time=times)
    opener: opening.SessionOpener = opening.open_simulated
    if level is not None:
        opener = real_autopilots(level=level, source=source or "vision", gcs=None, ardusub=ardusub)
    if endpoint:
        from angler_sitl.endpoints.opener import build_endpoint_opener

        opener = build_endpoint_opener(
            _read_settings(endpoint, system_id, of_vehicles),
            arm=arm,
            follow_plans=follow_plans,
            read_line=sys.stdin.readline,
        )
    report = partial(print, file=sys.stderr, flush=True)
    result, run = serving.serve_session(loaded, settings, openers, report, opener)
    _print_result(result)
    if run is not None:
        print(run.path)


def _check_vehicle_flags(
    endpoint: tuple[str, ...],
    flags: dict[str, Any],
    *,
    level: CommandLevel | None,
    pace: str,
) -> None:
    """Refuse flags of vehicles without an endpoint, and those that contradict one.

    Raises:
        ConfigError: naming the flag.
    """
    if not endpoint:
        for flag, value in flags.items():
            if value is not None:
                raise ConfigError(f"--{flag}: is of vehicles that run already; add --endpoint")
        return
    if level is not None:
        raise ConfigError(f"--level {level}: vehicles at endpoints are commanded in GUIDED alone")
    if pace != "real":
        raise ConfigError(f"--pace {pace}: vehicles at endpoints run by the clock; leave it out")
    if flags["follow-plans"] and not flags["arm"]:
        raise ConfigError("--follow-plans: nothing moves that is not armed; add --arm")


def _read_settings(
    endpoint: tuple[str, ...], system_id: tuple[int, ...], flags: dict[str, Any]
) -> "EndpointSettings":
    """Return the vehicles and limits of the command line."""
    from angler_mjx.cli.shared.origin import parse_origin
    from angler_sitl.endpoints.limits import parse_fence
    from angler_sitl.endpoints.losses import LossLimits
    from angler_sitl.endpoints.session import EndpointSettings
    from angler_sitl.wire.endpoint import parse_endpoint

    for text in endpoint:
        parse_endpoint(text)
    timeouts = {"link_s": flags["link-timeout"], "position_s": flags["position-timeout"]}
    others = {"max_speed_mps": flags["max-speed"], "at_end": flags["at-end"]}
    others |= {
        "fence": None if flags["fence"] is None else parse_fence(flags["fence"]),
        "origin": None if flags["origin"] is None else parse_origin(flags["origin"]),
    }
    return EndpointSettings(
        endpoints=endpoint,
        sysids=system_id,
        losses=LossLimits(**{key: value for key, value in timeouts.items() if value is not None}),
        **{key: value for key, value in others.items() if value is not None},
    )


def choose_backend(backend: BackendName) -> Literal["rclpy", "zenoh", "none"]:
    """Return the transport: rclpy where it can be imported, else Zenoh."""
    if backend != "auto":
        return backend
    return "zenoh" if find_spec("rclpy") is None else "rclpy"


def _list_openers(
    backend: BackendName, foxglove: bool, address: str, port: int, foxglove_port: int
) -> list[Callable[[], "Backend"]]:
    """Return openers of the requested transports."""
    for flag, number in (("port", port), ("foxglove-port", foxglove_port)):
        if not 0 < number < 2**16:
            raise ConfigError(f"--{flag} {number}: give a port from 1 to {2**16 - 1}")
    openers: list[Callable[[], Backend]] = []
    name = choose_backend(backend)
    if name == "zenoh":

        def open_zenoh() -> "Backend":
            from angler_mjx.serve.backends.zenoh_backend import ZenohBackend

            return ZenohBackend(address, port)

        openers.append(open_zenoh)
    if name == "rclpy":

        def open_rclpy() -> "Backend":
            from angler_mjx.serve.backends.rclpy_backend import RclpyBackend

            return RclpyBackend(is_local=address == LOOPBACK)

        openers.append(open_rclpy)
    if foxglove:

        def open_foxglove() -> "Backend":
            from angler_mjx.serve.backends.foxglove_backend import FoxgloveBackend

            return FoxgloveBackend(address, foxglove_port)

        openers.append(open_foxglove)
    if not openers:
        raise ConfigError("--backend none: nothing to serve; add --foxglove")
    return openers


def _print_result(result: "DoorResult") -> None:
    """Print the result, in a line for all and a line for each robot."""
    pace = "" if result.overruns is None else f", {result.overruns}"
    print(
        f"{result.scene_s:.2f} s of the scene in {result.wall_s:.2f} s, "
        f"{result.steps} steps{pace}\n"
        f"{result.sent} messages sent, {result.received} received, {result.refused} refused"
    )
    for i, status in enumerate(result.last.status):
        print(f"robot_{i}: {status.outcome.name.lower()}, {status.command}")
