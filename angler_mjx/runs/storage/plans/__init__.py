"""Problems and plans on disk: written, and read again; see ``docs/reference/plan_files.md``."""
