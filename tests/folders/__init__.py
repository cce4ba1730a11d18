"""Folders as an earlier version wrote them, and the commands that read them."""

import re
import tomllib
from pathlib import Path

BESIDE = Path(__file__).parent
ROOT = BESIDE.parents[1]
TABLE = tomllib.loads((BESIDE / "folders.toml").read_text(encoding="utf-8"))


def write_inputs(folder):
    """Write the files that commands of folders.toml read into a folder.

    Raises:
        AssertionError: a file holds no such key.
    """
    for name, row in TABLE["inputs"].items():
        text = (ROOT / row["of"]).read_text(encoding="utf-8")
        for key, value in row.get("keys", {}).items():
            text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
            assert count, f"{row['of']}: has no key {key}"
        (folder / name).write_text(text, encoding="utf-8")
    page = (ROOT / "docs" / "tutorials" / "own_planner.md").read_text(encoding="utf-8")
    blocks = re.findall(r"(?ms)^```python\n(.*?)^```", page)
    source = next(block for block in blocks if "class Straight" in block)
    (folder / "straight.py").write_text(source, encoding="utf-8")
