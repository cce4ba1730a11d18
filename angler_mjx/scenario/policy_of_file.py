"""Policies of users' files, which a scenario names FILE.py:CLASS."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import jax

from angler_mjx.errors import ConfigError, describe_error, format_value
from angler_mjx.sim.information import LEVELS, Information
from angler_mjx.sim.policy import Policy
from angler_mjx.user_classes import load_class


def is_policy_class(name: str) -> bool:
    """Return whether FILE.py:CLASS is a class of policies.

    Raises:
        ConfigError: the file cannot be read or run, or holds no such class.
    """
    return issubclass(load_class(name, "class"), Policy)


def build_policy_of_file(
    name: str, settings: Mapping[str, object], information: Information | None
) -> Policy:
    """Build the policy of a class of a file.

    Args:
        name: FILE.py:CLASS.
        settings: arguments of the class.
        information: level of what it gets; that of the class if None.

    Raises:
        ConfigError: the file cannot be run, its class is no policy or does not take the settings,
            or it has no field for another level than its own.
    """
    policy_class, title = load_class(name, "policy"), f"policy {format_value(name)}"
    if not issubclass(policy_class, Policy):
        raise ConfigError(f"{title}: is no class of angler_mjx.Policy")
    try:
        policy = policy_class(**settings)
    except Exception as error:  # a user's code may raise any exception; the message names it
        reason = describe_error(error, Path(name.rpartition(":")[0]))
        raise ConfigError(
            f"{title}: cannot be made of [policy.{policy_class.__name__}] ({reason})"
        ) from error
    if not is_dataclass(policy) or any(leaf is policy for leaf in jax.tree.leaves(policy)):
        raise ConfigError(
            f"{title}: is no pytree; decorate it with jax.tree_util.register_dataclass and "
            "dataclass(frozen=True, kw_only=True)"
        )
    return policy if information is None else _limit(policy, information, title)


def _limit(policy: Policy, information: Information, title: str) -> Policy:
    """Return a policy that gets no more than an information level."""
    asked = policy.information
    if asked is None:
        return policy
    if is_dataclass(policy) and "information" in {field.name for field in fields(policy)}:
        return replace(policy, information=information)
    for part in ("obstacles", "current"):
        level, limit = getattr(asked, part), getattr(information, part)
        if LEVELS.index(level) > LEVELS.index(limit):
            raise ConfigError(
                f"{title}: asks for information.{part} = {format_value(level)}, and "
                f"{format_value(limit)} is given; make information a static field of the class, "
                "so that it can be replaced"
            )
    return policy
