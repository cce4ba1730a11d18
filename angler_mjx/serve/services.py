"""Requests of the services of a session, and their answers."""

from dataclasses import dataclass

from angler_mjx.errors import ConfigError
from angler_mjx.report.interop.ros_encoding import find_encoder
from angler_mjx.serve.decoding import decode_message

SEED_PARAMETER = "seed"
_INTEGER = 2
"""Type of ``rcl_interfaces/ParameterValue``."""
MAX_SEED = 2**31 - 1


@dataclass(frozen=True, kw_only=True)
class SeedAnswer:
    """Answer to a request for parameters."""

    data: bytes
    seed: int | None
    """Seed of the next reset; None if it stays."""


def decode_pause(data: bytes) -> bool:
    """Return whether to pause.

    Raises:
        ConfigError: the bytes are no request.
    """
    return bool(decode_message("std_srvs/SetBool_Request", data).data)


def encode_trigger(success: bool, message: str) -> bytes:
    """Return the answer of a ``std_srvs/Trigger`` or ``SetBool``."""
    return bytes(
        find_encoder("std_srvs/Trigger_Response")({"success": success, "message": message})
    )


def answer_parameters(data: bytes) -> SeedAnswer:
    """Return the answer to a ``rcl_interfaces/SetParameters``: only the seed can be set."""
    seed: int | None = None
    results = []
    try:
        parameters = decode_message("rcl_interfaces/SetParameters_Request", data).parameters
    except ConfigError as error:
        parameters, results = [], [{"successful": False, "reason": str(error)}]
    for parameter in parameters:
        value = parameter.value
        if parameter.name != SEED_PARAMETER:
            reason = f"{parameter.name}: only {SEED_PARAMETER} can be set"
        elif value.type != _INTEGER or not 0 <= value.integer_value <= MAX_SEED:
            reason = f"{SEED_PARAMETER}: must be an integer from 0 to {MAX_SEED}"
        else:
            reason, seed = "", int(value.integer_value)
        results.append({"successful": not reason, "reason": reason})
    encode = find_encoder("rcl_interfaces/SetParameters_Response")
    return SeedAnswer(data=bytes(encode({"results": results})), seed=seed)
