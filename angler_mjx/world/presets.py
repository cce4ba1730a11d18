"""The presets of worlds that come with the package, as data: one TOML file each."""

from functools import cache
from importlib import resources
from typing import Annotated, Literal

from pydantic import Field

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel, parse_model, read_toml
from angler_mjx.world.obstacles import ObstaclesConfig
from angler_mjx.world.rock.rules import Rule

_FOLDER = "data"
_OTHER_FILES = ("materials.toml",)
"""Files of the folder that are no presets."""


class Preset(FileModel):
    """A complete world without currents; density or fill for rules that start from random walls."""

    description: str
    source: str
    """Source of the numbers."""
    shape: tuple[int, int, int]
    cell_m: Annotated[float, Field(gt=0)]
    depth_m: Annotated[float, Field(ge=0)] = 2.0
    floor_depth_m: float | None = None
    rule: Rule
    density: float | None = None
    fill: float | None = None
    min_obstacles: int = 0
    placement: Literal["cross", "parallel", "random"] = "cross"
    horizon_s: Annotated[float, Field(gt=0, le=86400)] = 120.0
    """Default horizon of scenarios in this world: time for its paths."""
    obstacles: ObstaclesConfig = ObstaclesConfig()


def list_presets() -> tuple[str, ...]:
    """Return the names of all presets, sorted."""
    folder = resources.files("angler_mjx.world") / _FOLDER
    names = (entry.name for entry in folder.iterdir() if entry.name not in _OTHER_FILES)
    return tuple(sorted(n.removesuffix(".toml") for n in names if n.endswith(".toml")))


@cache
def load_preset(name: str) -> Preset:
    """Return a preset by name.

    Raises:
        ConfigError: there is no preset of that name.
    """
    if name not in list_presets():
        raise ConfigError(
            f"{format_value(name)} is no preset; there are {', '.join(list_presets())}"
        )
    with resources.as_file(resources.files("angler_mjx.world") / _FOLDER / f"{name}.toml") as path:
        return parse_model(Preset, read_toml(path), source=f"preset {name}")
