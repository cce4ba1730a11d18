"""Test files that can detect faults of a module, the nearest first: read from the imports."""

import ast
from collections import deque
from collections.abc import Mapping
from pathlib import Path

SOURCES = (".", "kernels", "sitl_bridge", "experiments")
"""Folders of the tree with packages."""
PACKAGES = ("angler_mjx", "angler_kernels", "angler_sitl", "angler_experiments")


class ImportGraph:
    """Import graph of the project's modules and test files."""

    def __init__(self, root: Path) -> None:
        """Read all files of a tree."""
        self._root = root
        self._module: dict[str, str] = {}
        """Module of each file."""
        package_folders = [
            (root / source / package, root / source)
            for source in SOURCES
            for package in PACKAGES
            if (root / source / package).is_dir()
        ]
        for folder, source in package_folders:
            for file in folder.rglob("*.py"):
                parts = file.relative_to(source).with_suffix("").parts
                name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
                self._module[file.relative_to(root).as_posix()] = name
        self._module_names = set(self._module.values())
        self._imports = {
            name: self._read_imports(root / file, name) for file, name in self._module.items()
        }
        self._tests = {
            file.relative_to(root).as_posix(): self._test_imports(file)
            for file in sorted((root / "tests").rglob("test_*.py"))
        }

    def measure_distances(self, file: str) -> dict[str, int]:
        """Return the import distance of the test files that reach a module; 1 is a direct import.

        Args:
            file: file of the module, from the root.
        """
        target = self._module[file]
        distance_by_test = {}
        for test, direct in self._tests.items():
            steps = self._count_steps(direct, target)
            if steps is not None:
                distance_by_test[test] = steps
        return distance_by_test

    def rank_tests(
        self, file: str, seconds: Mapping[str, float] | None = None, nearest: int | None = None
    ) -> list[str]:
        """Rank the test files of a module, the nearest first.

        Among equally near files, those beside the module come first, then those of its name, then
        the quick ones.

        Args:
            file: file of the module, from the root.
            seconds: duration of each test file; others are left out.
            nearest: maximum number of files, regardless of their durations.
        """
        distance = self.measure_distances(file)
        is_elsewhere = {test: not _is_beside(test, file) for test in distance}
        is_other_name = {test: Path(test).stem != f"test_{Path(file).stem}" for test in distance}
        names = sorted(distance, key=lambda t: (distance[t], is_elsewhere[t], is_other_name[t], t))[
            :nearest
        ]
        if seconds is None:
            return names
        timed = [test for test in names if test in seconds]
        return sorted(
            timed, key=lambda t: (distance[t], is_elsewhere[t], is_other_name[t], seconds[t], t)
        )

    def _count_steps(self, direct: Mapping[str, int], target: str) -> int | None:
        """Count the import steps from a test file's imports to a module."""
        steps = dict(direct)
        queue = deque(sorted(steps, key=lambda name: steps[name]))
        while queue:
            name = queue.popleft()
            for further in self._imports.get(name, set()):
                if steps[name] + 1 < steps.get(further, len(self._module_names)):
                    steps[further] = steps[name] + 1
                    queue.append(further)
        return steps.get(target)

    def _test_imports(self, file: Path) -> dict[str, int]:
        """Return imports of a test file and its helpers at distance 1, of a conftest alone at 2."""
        conftests = [
            self._root / folder / "conftest.py"
            for folder in file.relative_to(self._root).parents
            if (self._root / folder / "conftest.py").is_file()
        ]
        return dict.fromkeys(self._imports_with_helpers(conftests), 2) | dict.fromkeys(
            self._imports_with_helpers([file]), 1
        )

    def _imports_with_helpers(self, files: list[Path]) -> set[str]:
        """Return modules of the project that files import, with the helpers beside them."""
        modules, queue, seen = set[str](), list(files), set[Path]()
        while queue:
            path = queue.pop()
            if path not in seen:
                seen.add(path)
                modules |= self._read_imports(path, "")
                queue += self._find_helpers(path)
        return modules

    def _find_helpers(self, file: Path) -> list[Path]:
        """Find the files beside a test file that it imports by a relative name."""
        helpers = []
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                folder = file.parents[node.level - 1]
                names = [node.module] if node.module else [alias.name for alias in node.names]
                for name in names:
                    helper = folder.joinpath(*name.split(".")).with_suffix(".py")
                    helpers += [helper] if helper.is_file() else []
        return helpers

    def _read_imports(self, file: Path, module: str) -> set[str]:
        """Return the modules of the project that a file imports."""
        modules = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                modules.add(node.module)
                modules |= {f"{node.module}.{alias.name}" for alias in node.names}
        return (modules & self._module_names) - {module}


def _is_beside(test: str, file: str) -> bool:
    """Return whether a test file stands beside its module: tests/a/b/test_x.py and a/b/y.py."""
    folder = test.removeprefix("tests/").rpartition("/")[0]
    return file.startswith(folder + "/") or f"/{folder}/" in f"/{file}"
