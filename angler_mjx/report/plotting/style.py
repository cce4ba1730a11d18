"""Style of figures: colours for colour-blind readers, fonts, sizes, saving."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib import colors
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.runs.storage.atomic_files import wrap_write_errors, write_atomically

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

INK, QUIET, FAINT, PAPER = "#1b2733", "#5d6b78", "#c9d1d8", "#ffffff"
WATER = "#eef5f8"
CURRENT = "#6f9fb8"
OBSTACLE_DYNAMIC, OBSTACLE_STATIC = "#8a6fb0", "#55606b"

ROBOTS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7A4E12", "#333333")
"""Colours of robots, used in turn.

Okabe and Ito's (Color Universal Design, 2008) without yellow, which is lost on white, and with
brown and black."""

OUTCOMES = {
    "reached": "#009E73",
    "collision_static": "#7A4E12",
    "collision_dynamic": "#8a6fb0",
    "collision_robot": "#D55E00",
    "out_of_bounds": "#56B4E9",
    "timeout": "#E69F00",
    "diverged": "#333333",
    "failed": "#CC79A7",
    "damaged": "#882255",
    "dropped": "#44AA99",
}
"""One colour for each outcome."""

OUTCOME_TEXT = {
    "reached": "reached the goal",
    "collision_static": "hit rock or floor",
    "collision_dynamic": "hit a moving obstacle",
    "collision_robot": "hit another robot",
    "out_of_bounds": "left the cube",
    "timeout": "ran out of time",
    "diverged": "diverged",
    "failed": "broke down",
    "damaged": "hit too hard",
    "dropped": "lost its grip",
}
"""Outcomes in words."""

ROCK = colors.LinearSegmentedColormap.from_list(
    "rock", ["#93a3a6", "#b9bba8", "#ddd3b4", "#f1e6c8"]
)
"""Colour map of rock height, deep to shallow: light enough for tracks to stand out."""


def robot_color(index: int) -> str:
    """Return the colour of robot ``index``; colours repeat, so show the number as well."""
    return ROBOTS[index % len(ROBOTS)]


@contextmanager
def figure_style(*, parse_math: bool = True) -> Iterator[None]:
    """Apply the style of all figures, inside a ``with``; nothing global is changed.

    Args:
        parse_math: read text between dollar signs as formulas; not for names that users give.
    """
    settings: dict[RcKeyType, object] = {
        "font.family": "DejaVu Sans",
        "font.size": 9.5,
        "axes.titlesize": 11.5,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.titlepad": 9.0,
        "axes.labelcolor": QUIET,
        "axes.edgecolor": FAINT,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "text.color": INK,
        "xtick.color": QUIET,
        "ytick.color": QUIET,
        "xtick.major.size": 3.0,
        "ytick.major.size": 3.0,
        "grid.color": "#e4e9ed",
        "grid.linewidth": 0.8,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
        "figure.facecolor": PAPER,
        "savefig.facecolor": PAPER,
        "text.parse_math": parse_math,
    }
    with mpl.rc_context(settings):
        yield


def new_figure(width_in: float, height_in: float, *, headline_in: float = 0.0) -> Figure:
    """Return an empty figure that needs no display and no pyplot.

    Args:
        width_in: width, inch.
        height_in: height, inch.
        headline_in: height kept free at the top for `add_headline`, inch.
    """
    engine = ConstrainedLayoutEngine(
        rect=(0.0, 0.0, 1.0, 1.0 - headline_in / height_in), w_pad=0.1, h_pad=0.07
    )
    figure = Figure(figsize=(width_in, height_in), layout=engine)
    FigureCanvasAgg(figure)
    return figure


@contextmanager
def titled_figure(
    width_in: float,
    height_in: float,
    title: str,
    subtitle: str,
    *,
    headline_in: float = 0.65,
    parse_math: bool = True,
) -> Iterator[Figure]:
    """Give an empty figure with a headline, inside a ``with`` that applies the style.

    Args:
        width_in: width, inch.
        height_in: height, inch.
        title: first line of the headline.
        subtitle: quieter line below it.
        headline_in: height of the headline, inch.
        parse_math: as of `figure_style`.
    """
    with figure_style(parse_math=parse_math):
        figure = new_figure(width_in, height_in, headline_in=headline_in)
        add_headline(figure, title, subtitle)
        yield figure


def add_headline(figure: Figure, title: str, subtitle: str) -> None:
    """Add a title and a quieter line below it, at the top left of a figure."""
    left, inch = 0.1 / figure.get_figwidth(), 1.0 / figure.get_figheight()
    figure.text(left, 1 - 0.1 * inch, title, fontsize=13.5, fontweight="bold", va="top")
    figure.text(left, 1 - 0.38 * inch, subtitle, fontsize=9.5, color=QUIET, va="top")


FIGURE_FORMATS = (".png", ".pdf", ".svg", ".jpg")
"""Supported file name extensions of figures."""


def require_format(path: Path, flag: str = "--out") -> None:
    """Refuse a file name without a supported figure format, before anything is plotted.

    Raises:
        ConfigError: naming the supported formats.
    """
    if path.suffix.lower() not in FIGURE_FORMATS:
        raise ConfigError(
            f"{flag} {format_path(path)}: give a name that ends in {', '.join(FIGURE_FORMATS)}"
        )


def save_figure(figure: Figure, path: Path, *, palette: int | None = None) -> Path:
    """Write a figure, as PNG or in the format of its name; return the path.

    Args:
        figure: figure to write.
        path: of the file.
        palette: max number of colours; a third of the size for lines on paper.

    Raises:
        ConfigError: the extension is no format of figures.
        RunError: the file cannot be written.
    """
    formats = figure.canvas.get_supported_filetypes()
    if path.suffix.removeprefix(".").lower() not in formats:
        raise ConfigError(
            f"{path}: a figure cannot be written as {path.suffix or 'a name without ending'}; "
            "give a name that ends in .png, .svg or .pdf"
        )
    with wrap_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as writing:
            figure.savefig(writing, dpi=160)
            if palette is not None:
                with Image.open(writing) as image:
                    image.convert("RGB").quantize(palette).save(writing, optimize=True)
    return path
