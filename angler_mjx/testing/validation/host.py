"""Host of a measurement."""

import os


def describe_host() -> dict[str, object]:
    """Return versions, machine and commit of this process, and its rounding or test settings."""
    from angler_mjx.runs.provenance import describe_environment

    environment = describe_environment()
    machine = ("platform", "processor", "cpu_count", "backend", "device")
    keys = ("versions", "python", "xla_flags", "commit", *machine)
    return {
        **{name: environment[name] for name in keys},
        "ardusub": "ANGLER_ARDUSUB" in os.environ,
    }
