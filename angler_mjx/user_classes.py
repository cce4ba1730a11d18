"""Classes of users' files, named FILE.py:CLASS."""

import hashlib
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

from angler_mjx.errors import ConfigError, describe_error, format_value

USER_MODULE = "angler_mjx_user_"
"""Beginning of the names of modules of users' files."""


def is_class_of_file(name: str) -> bool:
    """Return whether a name is FILE.py:CLASS."""
    return name.rpartition(":")[0].endswith(".py")


def make_name_absolute(name: str, folder: Path) -> str:
    """Return FILE.py:CLASS with the file's absolute path, taken from a folder; other names stay."""
    path, _, qualname = name.rpartition(":")
    return f"{(folder / path).absolute()}:{qualname}" if is_class_of_file(name) else name


def load_class(name: str, kind: str) -> type:
    """Return the class of FILE.py:CLASS; the same one as long as the text of the file is the same.

    Args:
        name: FILE.py:CLASS.
        kind: noun for messages, like "control law".

    Raises:
        ConfigError: the file cannot be read or run, or holds no such class.
    """
    path, _, qualname = name.rpartition(":")
    try:
        text = Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{kind} {format_value(name)}: {path} cannot be read ({error.strerror or error})"
        ) from error
    value = getattr(load_module(path, text), qualname, None)
    if not isinstance(value, type):
        raise ConfigError(
            f"{kind} {format_value(name)}: {path} holds no class {format_value(qualname)}"
        )
    return value


@cache
def load_module(path: str, text: bytes) -> ModuleType:
    """Run the text of a user's file as a module, once in each process.

    It can import files beside it. Another text is another module. A process that is given the
    text runs it also after the file was edited, and on a machine without the file.

    Raises:
        ConfigError: the text cannot be run.
    """
    file = Path(path)
    name = f"{USER_MODULE}{file.stem}_{hashlib.sha256(path.encode() + text).hexdigest()[:16]}"
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    module = ModuleType(name)
    module.__file__ = path
    sys.modules[name] = module
    try:
        exec(compile(text, path, "exec"), vars(module))
    except Exception as error:  # a user's code may raise any exception; the message names it
        del sys.modules[name]
        raise ConfigError(f"{path}: cannot be run ({describe_error(error, file)})") from error
    return module
