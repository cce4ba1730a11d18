"""Steps that bring autopilots up side by side: requests repeated until their effect is seen.

The steps of one autopilot are an iterator, which yields whenever time has to go on.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import RunError
from angler_sitl.steering.autopilot_commander import AutopilotCommander, mode_name

_RETRY_PERIOD_S = 1.0
"""Period after which a request without effect is repeated."""
_DONE = object()

_REFUSALS = {
    dialect.MAV_RESULT_TEMPORARILY_REJECTED: "not now",
    dialect.MAV_RESULT_DENIED: "denied",
    dialect.MAV_RESULT_UNSUPPORTED: "unknown to it",
    dialect.MAV_RESULT_FAILED: "failed",
}


@dataclass(kw_only=True)
class BootClock:
    """Clock of the steps."""

    time_s: float


def run_steps(
    pending: Sequence[Iterator[None]], clock: BootClock, advance: Callable[[], float]
) -> None:
    """Run the steps of several autopilots until all are done.

    Args:
        pending: steps of each.
        clock: their clock.
        advance: lets time go on, and returns it.

    Raises:
        RunError: one of them is not followed in time.
    """
    left = list(pending)
    while left:
        left = [steps for steps in left if next(steps, _DONE) is not _DONE]
        if left:
            clock.time_s = advance()


def send_until_followed(
    pilot: AutopilotCommander,
    clock: BootClock,
    limit_s: float,
    command: int,
    parameters: tuple[float, ...],
    mode: int,
) -> Iterator[None]:
    """Repeat a command until the heartbeat shows its effect."""
    arming = command == dialect.MAV_CMD_COMPONENT_ARM_DISARM

    def is_followed() -> bool:
        return pilot.armed if arming else pilot.mode == mode

    def resend() -> None:
        pilot.link.command(command, *parameters)

    failure_text = "refuses to arm" if arming else f"refuses the mode {mode_name(mode)}"
    yield from wait_until(is_followed, pilot, clock, limit_s, failure_text, resend, command)


def wait_until(
    condition: Callable[[], bool],
    pilot: AutopilotCommander,
    clock: BootClock,
    limit_s: float,
    failure_text: str,
    retry: Callable[[], None] | None = None,
    command: int | None = None,
) -> Iterator[None]:
    """Wait until a condition holds, with repeated requests.

    Raises:
        RunError: it does not hold in time.
    """
    end, due = clock.time_s + limit_s, clock.time_s
    while not condition():
        if clock.time_s >= end:
            raise RunError(_format_failure(pilot, failure_text, limit_s, command))
        if retry is not None and clock.time_s >= due:
            retry()
            due = clock.time_s + _RETRY_PERIOD_S
        yield


def _format_failure(
    pilot: AutopilotCommander, failure_text: str, limit_s: float, command: int | None
) -> str:
    """Return the failure, the autopilot's status, and its own last texts."""
    message = f"{pilot.name}: {failure_text} within {limit_s:g} s of its own clock"
    if pilot.link.latest:
        message += f" ({pilot.note()})"
    answer = None if command is None else pilot.link.acks.get(command)
    if answer in _REFUSALS:
        message += f"; its answer is: {_REFUSALS[answer]}"
    last_texts = pilot.link.format_last_texts()
    return f"{message}; ArduSub says: {last_texts}" if last_texts else message


def request_version(pilot: AutopilotCommander) -> None:
    """Request AUTOPILOT_VERSION, unless it has come; no flight waits for it."""
    if "AUTOPILOT_VERSION" not in pilot.link.latest:
        pilot.link.command(
            dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        )
