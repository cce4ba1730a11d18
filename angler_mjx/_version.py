"""Version of this release; both distributions, and all that names it, take it from here."""

__version__ = "1.0.0rc1"
