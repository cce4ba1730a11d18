"""Pages of the notebooks: their cells and stored outputs as Markdown."""

import base64
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.site.menu import MenuError

BADGE = re.compile(r"^\[!\[Open in Colab\]\([^)]*\)\]\(([^)]*)\)\n\n?", re.M)
"""Badge of a notebook, with the address that it leads to; a page loads no picture of others."""


def format_page(notebook: Path) -> str:
    """Return a notebook as Markdown, with the pictures that `list_pictures` returns.

    Raises:
        MenuError: a cell of code was stored without having run.
    """
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    lines: list[str] = []
    pictures = iter(list_pictures(notebook))
    for number, cell in enumerate(cells):
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            badge = BADGE.search(text)
            lines += [BADGE.sub("", text), ""]
            if number == 0:
                file = f"docs/{notebook.parent.name}/{notebook.name}"
                colab = (
                    f" [Open it in Colab]({badge[1]})." if badge and _is_filled(badge[1]) else ""
                )
                lines += [f"Open it in Jupyter: {{download}}`{file} <{notebook.name}>`.{colab}", ""]
            continue
        if cell["execution_count"] is None:
            raise MenuError(
                f"{notebook.name}: cell {number} was not run; python -m tools.notebooks"
            )
        lines += _fence(text, _language(text))
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                lines += [f"![Output of the cell above]({next(pictures)})", ""]
            elif shown := _join(output.get("text", data.get("text/plain", ""))).strip():
                lines += _fence(shown, "text")
    return "\n".join(lines)


def list_pictures(notebook: Path) -> Mapping[str, bytes]:
    """Return the pictures among the outputs of a notebook, by the names of their files."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    pictures = [
        base64.b64decode(_join(output["data"]["image/png"]))
        for cell in cells
        for output in cell.get("outputs", ())
        if "image/png" in output.get("data", {})
    ]
    return {f"{notebook.stem}_{number}.png": data for number, data in enumerate(pictures)}


def _is_filled(address: str) -> bool:
    """Return whether the owner has named the repository of an address."""
    return "OWNER/REPOSITORY" not in address


def _join(text: Any) -> str:
    return "".join(text)


LANGUAGES = {".cpp": "cpp", ".toml": "toml", ".urdf": "xml", ".py": "python"}
"""Languages of the files that cells write, by the ends of their names."""


def _language(text: str) -> str:
    first = text.partition("\n")[0]
    if first.startswith("%%writefile "):
        return LANGUAGES.get(Path(first).suffix, "text")
    if first == "%%bash":
        return "bash"
    return "ipython3" if re.search(r"^ *[%!]", text, re.M) else "python"


def _fence(text: str, language: str) -> Sequence[str]:
    # A magic is no Python: Pygments would mark the whole cell as wrong.
    first, _, rest = text.partition("\n")
    if first.startswith("%%writefile "):
        name = first.removeprefix("%%writefile ")
        if language == "xml":  # a comment before its first line is no XML
            return [f"`{name}`:", "", f"````{language}", rest, "````", ""]
        text = f"{'//' if language == 'cpp' else '#'} {name}\n{rest}"
    elif first == "%%bash":
        text = rest
    return [f"````{language}", text, "````", ""]
