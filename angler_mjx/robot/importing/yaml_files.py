"""YAML files of foreign vehicles, read into plain values."""

from pathlib import Path

import yaml

from angler_mjx.errors import ConfigError

MAX_YAML_BYTES = 1 << 20


def _refuse_aliases(data: bytes) -> None:
    """Refuse aliases, by which a small file expands without bound."""
    for event in yaml.parse(data, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="aliases are not read", problem_mark=event.start_mark
            )


def read_yaml(path: Path) -> object:
    """Read a YAML file into plain values.

    Raises:
        ConfigError: it cannot be read, is too large, or no YAML; names file and line.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    if len(data) > MAX_YAML_BYTES:
        raise ConfigError(f"{path}: {len(data)} bytes; {MAX_YAML_BYTES} at most are read")
    try:
        _refuse_aliases(data)
        return yaml.safe_load(data)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(f"{path}:{line}: no YAML ({error.problem}); correct it") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: no YAML ({' '.join(str(error).split())[:80]})") from error


def find_key_lines(path: Path) -> dict[str, int]:
    """Return the lines of the keys of a YAML file and of tables in it; a name counts once."""
    lines: dict[str, int] = {}
    data = path.read_bytes()
    _refuse_aliases(data)
    nodes = [yaml.compose(data, yaml.SafeLoader)]
    while nodes:
        node = nodes.pop()
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                lines.setdefault(str(key.value), key.start_mark.line + 1)
                nodes.append(value)
    return lines
