"""The errors that angler raises at its boundary.

Inside traced code nothing raises: a robot that diverges carries an outcome. Everything here is
raised on the host, before or after a device call, and says what was wrong, where, and what to do.
"""


class AnglerError(Exception):
    """Base of every error that angler raises on purpose; the CLI prints it and exits with 2."""


class ConfigError(AnglerError, ValueError):
    """A file, flag or argument holds something that cannot be used."""


class UnsupportedError(AnglerError, NotImplementedError):
    """What was asked for exists elsewhere: another engine, device or extra."""


class RunError(AnglerError, RuntimeError):
    """A run cannot start or go on: folder, disk, device."""
