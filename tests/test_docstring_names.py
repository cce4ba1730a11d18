"""Dotted names in docstrings and pages, such as `module.function`, resolve to names of the code.

A name is checked if it begins with a module or class of ours. Only the source is read.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = {
    "angler_mjx": "angler_mjx",
    "angler_kernels": "kernels/angler_kernels",
    "angler_sitl": "sitl_bridge/angler_sitl",
    "angler_experiments": "experiments/angler_experiments",
    "tools": "tools",
}
NAME = re.compile(r"`([A-Za-z_]\w*(?:\.\w+)+)`")
SUFFIXES = frozenset(
    [
        *("csv", "hdf5", "html", "json", "jsonl", "log", "md", "npz", "param", "params"),
        *("parquet", "png", "py", "rrd", "sqlite", "toml", "txt", "xml", "zarr"),
    ]
)
"""Last parts of file names."""
OTHERS = {
    "contact.restitution": "a term of `angler validate`",
    "config.call": "an argument of the function",
    "fleet.0.count": "a key of scenario files",
    "grain.MapDataset": "a library",
    "inputs.others.payload": "an argument of the method",
    "mjx.step": "a library",
    "params.vehicle": "a field",
    "planner.NAME": "a key of scenario files",
    "planner.information": "a key of scenario files",
}
"""Names that only look like those of a module, each with its meaning."""


def bound_names(tree: ast.AST) -> set[str]:
    """Names that a module or class binds, attributes of self and names inside it included."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.id if isinstance(node, ast.Name) else node.attr)
        elif isinstance(node, ast.alias):
            names.add((node.asname or node.name).split(".")[0])
    return names


class Index:
    """Modules by dotted path, and members of classes by name, those of bases included."""

    def __init__(self, sources: dict[str, str]) -> None:
        self.trees = {module: ast.parse(text) for module, text in sources.items()}
        self.modules = {module: bound_names(tree) for module, tree in self.trees.items()}
        self._members = defaultdict(set)
        self._bases = defaultdict(set)
        for node in (node for tree in self.trees.values() for node in ast.walk(tree)):
            if isinstance(node, ast.ClassDef):
                self._members[node.name] |= bound_names(node)
                bases = (ast.unparse(base).split("[")[0] for base in node.bases)
                self._bases[node.name] |= {base.split(".")[-1] for base in bases}

    def members(self, name: str) -> set[str]:
        return self._members[name].union(
            *(self.members(base) for base in self._bases[name] - {name})
        )

    def is_class(self, name: str) -> bool:
        return name in self._members

    def resolves(self, name: str) -> bool | None:
        """Whether a name resolves; None where it begins with no module or class of ours."""
        parts = name.split(".")
        if self.is_class(parts[0]) and parts[1] in self.members(parts[0]):
            return True
        seen = self.is_class(parts[0])
        for split in range(1, len(parts) + 1):
            prefix, rest = "." + ".".join(parts[:split]), parts[split:]
            for module, names in self.modules.items():
                if ("." + module).endswith(prefix):
                    seen = True
                    if not rest or (rest[0] in names and self._has_member(*rest[:2])):
                        return True
        return False if seen else None

    def _has_member(self, name: str, member: str | None = None) -> bool:
        return member is None or not self.is_class(name) or member in self.members(name)


def read_sources() -> dict[str, str]:
    sources = {}
    for package, folder in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = [package, *path.relative_to(ROOT / folder).with_suffix("").parts]
            module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            sources[module] = path.read_text(encoding="utf-8")
    return sources


def documented_names(tree: ast.AST) -> Iterator[str]:
    """Dotted names between single backticks in strings that stand alone."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield from NAME.findall(text)


def stale_names(index: Index) -> dict[str, set[str]]:
    """Names that do not resolve, with the modules whose docstrings hold them."""
    stale = defaultdict(set)
    for module, tree in index.trees.items():
        for name in documented_names(tree):
            if name.split(".")[-1] not in SUFFIXES and index.resolves(name) is False:
                stale[name].add(module)
    return stale


def test_names_in_docstrings_resolve():
    stale = stale_names(Index(read_sources()))
    assert {name: modules for name, modules in stale.items() if name not in OTHERS} == {}
    assert set(OTHERS) <= set(stale), "these are gone: remove them from OTHERS"


PAGES = (
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *(ROOT / name / "README.md" for name in ("experiments", "kernels", "sitl_bridge")),
    *sorted((ROOT / "docs").rglob("*.md")),
)
GROUPS = {"angler_mjx.planners": "a group of entry points"}
"""Names on pages that only look like those of a module, each with its meaning."""


def test_dotted_names_on_pages_resolve():
    """Those that begin with one of our packages; paths of before, which still import, do not."""
    index, missing, seen = Index(read_sources()), defaultdict(set), set()
    packages = "|".join(name for name in FOLDERS if name != "tools")
    for page in PAGES:
        text = re.sub(r"(?ms)^ *```.*?^ *```", "", page.read_text(encoding="utf-8"))
        for span in re.findall(r"`([^`]+)`", text):
            for name in re.findall(rf"(?<![\w./])(?:{packages})(?:\.\w+)+", span):
                seen.add(name)
                if name.split(".")[-1] not in SUFFIXES and not index.resolves(name):
                    missing[name].add(page.relative_to(ROOT).as_posix())
    assert {name: pages for name, pages in missing.items() if name not in GROUPS} == {}
    assert len(seen) > 40


SAMPLE = {
    "a": "",
    "a.tools": "class Base:\n    x: int\nclass Saw(Base):\n    def f(self):\n        self.y = 1\n",
    "a.use": "import numpy as np\ndef run(): ...\n",
}


@pytest.mark.parametrize(
    ("name", "resolved"),
    [
        ("tools.Saw", True),
        ("a.tools.Saw.f", True),
        ("Saw.x", True),
        ("Saw.y", True),
        ("a.use", True),
        ("Saw.bend", False),
        ("tools.Saw.bend", False),
        ("use.walk", False),
        ("a.gone", False),
        ("np.asarray", None),
    ],
)
def test_a_name_resolves_by_module_class_or_base(name, resolved):
    assert Index(SAMPLE).resolves(name) is resolved
