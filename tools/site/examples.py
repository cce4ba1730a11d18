"""Page of the examples: the files of docs/examples, each with the first line of its text."""

import ast
import re
from pathlib import Path

PAGE = re.compile(r"docs/([a-z0-9_/]+\.md)")
FIRST = ("rollout", "planner", "policy", "session", "current", "vehicle", "task", "gradient")
LANGUAGES = {".py": "python", ".cpp": "cpp", ".toml": "toml"}


def write_pages(folder: Path, target: Path) -> None:
    """Write the page of all examples.

    Args:
        folder: files of the examples.
        target: folder of the staged sources, which has a copy of the files in ``examples``.
    """
    lines = [
        "# Examples",
        "",
        "Each file runs as it stands, after the [installation](index.md#install). Tests run all; "
        "nodes of ROS 2 are only made by them, where there is rclpy.",
        "",
    ]
    for file in sorted(folder.iterdir(), key=_order):
        if file.suffix not in LANGUAGES:
            continue
        title, text = read_description(file)
        lines += [
            f"## {title}",
            "",
            PAGE.sub(r"[\1](\1)", text),
            "",
            f"[`docs/examples/{file.name}`](examples/{file.name})",
            "",
            f"```{{literalinclude}} examples/{file.name}",
            f":language: {LANGUAGES[file.suffix]}",
            "```",
            "",
        ]
    (target / "examples.md").write_text("\n".join(lines), encoding="utf-8")


def _order(file: Path) -> tuple[int, bool, str]:
    """Order files by `FIRST`, then other Python files, then the rest."""
    first = FIRST.index(file.stem) if file.stem in FIRST else len(FIRST)
    return first, file.suffix != ".py", file.name


def read_description(file: Path) -> tuple[str, str]:
    """Return the title of an example and the rest of its text: its docstring or first comment."""
    source = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        text = ast.get_docstring(ast.parse(source)) or file.stem
    else:
        found = re.match(r"(?:(?://|#) ?.*\n)+", source)
        text = re.sub(r"(?m)^(?://|#) ?", "", found[0]) if found else file.stem
    first, _, rest = text.strip().partition("\n\n")
    sentence, _, more = " ".join(first.split()).partition(". ")
    title, _, detail = sentence.rstrip(".").partition(": ")
    detail = f"{detail[:1].upper()}{detail[1:]}." if detail else ""
    return title, "\n\n".join(part for part in (" ".join((detail, more)).strip(), rest) if part)
