"""Answers to requests for parameters, read by rosbags."""

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from angler_mjx.serve.services import answer_parameters

from .memory_backend import HEADER, TYPES, set_parameter

INTEGER, DOUBLE = 2, 3
"""Types of ``rcl_interfaces/ParameterValue``."""
TYPES.register(
    get_types_from_msg(
        "rcl_interfaces/SetParametersResult[] results", "rcl_interfaces/msg/Response"
    )
)


def request(data):
    """Return whether each parameter was set, the reasons, and the seed of the next reset."""
    answer = answer_parameters(data)
    results = TYPES.deserialize_cdr(answer.data, "rcl_interfaces/msg/Response").results
    return [r.successful for r in results], [r.reason for r in results], answer.seed


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 1])
def test_a_seed_is_set_from_0_to_the_greatest(seed):
    assert request(set_parameter("seed", INTEGER, seed)) == ([True], [""], seed)


@pytest.mark.parametrize("seed", [-1, 2**31])
def test_a_seed_beyond_is_refused(seed):
    successful, (reason,), answered = request(set_parameter("seed", INTEGER, seed))
    assert (successful, answered) == ([False], None)
    assert "from 0 to 2147483647" in reason


@pytest.mark.parametrize(("name", "kind"), [("seed", DOUBLE), ("speed", INTEGER)])
def test_another_type_or_name_is_refused(name, kind):
    successful, (reason,), seed = request(set_parameter(name, kind, 5))
    assert (successful, seed) == ([False], None)
    assert reason.startswith(f"{name}: ")


@pytest.mark.parametrize("data", [b"", HEADER, HEADER + b"\xff" * 12])
def test_bytes_that_are_no_request_are_refused_with_a_reason(data):
    successful, (reason,), seed = request(data)
    assert (successful, seed) == ([False], None)
    assert "SetParameters" in reason


def test_each_parameter_of_a_request_has_its_answer():
    make = TYPES.types
    empty = [np.zeros(0, kind) for kind in ("u1", "?", "i8", "f8")]
    parameters = [
        make["rcl_interfaces/msg/Parameter"](
            name,
            make["rcl_interfaces/msg/ParameterValue"](INTEGER, False, value, 0.0, "", *empty, []),
        )
        for name, value in (("speed", 1), ("seed", 7))
    ]
    message = make["rcl_interfaces/msg/Request"](parameters)
    data = bytes(TYPES.serialize_cdr(message, "rcl_interfaces/msg/Request"))
    successful, reasons, seed = request(data)
    assert (successful, seed) == ([False, True], 7)
    assert reasons[1] == ""
