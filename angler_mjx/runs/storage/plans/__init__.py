"""Problems and plans on disk: written, and read again; see ``docs/planners.md``."""
