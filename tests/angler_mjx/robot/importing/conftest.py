"""Import of a text as a file, and its notes."""

import tomllib
from dataclasses import dataclass

import pytest

from angler_mjx.robot.importing.import_vehicle import import_vehicle


@dataclass
class Imported:
    """Tables of an imported file and the lines of its list."""

    table: dict
    notes: list
    trim: object

    @property
    def numbers(self):
        return self.table["parameter_sets"]["imported"]

    def noted(self, *parts):
        """Notes that hold all these parts."""
        return [note for note in self.notes if all(part in note for part in parts)]


@pytest.fixture
def bring(tmp_path):
    """Write files and import the first one."""

    def bring(text, name="rov.urdf", thruster="t200", files=(), **options):
        for other, content in dict(files).items():
            path = tmp_path / other
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        made = import_vehicle(path, thruster, **options)
        return Imported(tomllib.loads(made.text), [str(note) for note in made.notes], made.trim)

    return bring
