"""Where faults can be put, and a random sample of them."""

import ast
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator

from tools.mutants.mutant import Mutant, changed
from tools.mutants.operators import families

_TRIES = 20
"""Faults that are drawn at one place until one of them is Python and changes something."""


@dataclass(frozen=True, kw_only=True)
class _CodePosition:
    file: str
    family: str
    start: tuple[int, int]
    choices: tuple[tuple[str, int], ...]
    """Operators, and which of its occurrences in the file this is."""


def sample(root: Path, folders: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Mutants at ``count`` places, all places being equally likely; one at each.

    Args:
        root: of the tree.
        folders: whose modules are mutated, from the root.
        count: how many; all places in random order if there are fewer.
        seed: of the choice.
    """
    operators = families()
    found = [
        place
        for folder in folders
        for file in sorted((root / folder).rglob("*.py"))
        for place in _places(operators, file.relative_to(root).as_posix(), file.read_text())
    ]
    rng = random.Random(seed)
    rng.shuffle(found)
    known = {name: one for family in operators.values() for name, one in family.items()}
    mutants: list[Mutant] = []
    for place in found:
        if len(mutants) == count:
            break
        mutant = _mutant(known, root, place, rng)
        if mutant is not None:
            mutants.append(mutant)
    return mutants


def _places(
    operators: dict[str, dict[str, Operator]], file: str, code: str
) -> Iterator[_CodePosition]:
    """All places of a file, in the order of the operators' families and then of the file."""
    nodes = list(ast_nodes(get_ast(code)))
    # The bare stars and strokes of parameters are no products: a call by name is the same.
    bare = [node for node in nodes if node.type == "operator" and node.parent.type == "parameters"]
    spared = [*_spared(code), *((node.start_pos, node.end_pos) for node in bare)]
    for family, each in operators.items():
        at: dict[tuple[int, int], list[tuple[str, int]]] = {}
        for name, operator in each.items():
            starts = (start for node in nodes for start, _ in operator.mutation_positions(node))
            for occurrence, start in enumerate(starts):
                at.setdefault(start, []).append((name, occurrence))
        for start, choices in sorted(at.items()):
            if not any(low <= start < high for low, high in spared):
                yield _CodePosition(file=file, family=family, start=start, choices=tuple(choices))


def _mutant(
    known: dict[str, Operator], root: Path, place: _CodePosition, rng: random.Random
) -> Mutant | None:
    before = (root / place.file).read_text()
    for _ in range(_TRIES):
        operator, occurrence = rng.choice(place.choices)
        after = mutate_code(before, known[operator], occurrence)
        if after is None or not _is_other_python(before, after):
            continue
        return changed(
            file=place.file,
            before=before,
            after=after,
            line=place.start[0],
            operator=operator,
            fault=str(occurrence),
        )
    return None


def _is_other_python(before: str, after: str) -> bool:
    try:
        return ast.dump(ast.parse(before)) != ast.dump(ast.parse(after))
    except SyntaxError:
        return False


def _spared(code: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Ranges that no test could or should judge: from (line, column) up to before another.

    Annotations, decorators, imports, what is raised and what it says, formatted text, ``__repr__``,
    aliases of types, asserts, and ``strict=`` of ``zip``, which only guards against ourselves.
    """
    lines = code.splitlines(keepends=True)

    def place(line: int, column: int) -> tuple[int, int]:
        """Python counts bytes, Cosmic Ray characters."""
        return line, len(lines[line - 1].encode()[:column].decode())

    return [
        (place(node.lineno, node.col_offset), place(node.end_lineno, node.end_col_offset))
        for node in _unjudged(ast.parse(code))
        if node.end_lineno is not None and node.end_col_offset is not None
    ]


def _unjudged(tree: ast.Module) -> Iterator[ast.expr | ast.stmt]:
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                yield from node.decorator_list
                if node.returns is not None:
                    yield node.returns
                if node.name in ("__repr__", "__str__"):
                    yield node
            case ast.ClassDef():
                yield from node.decorator_list
            case (
                ast.arg(annotation=ast.expr() as annotation) | ast.AnnAssign(annotation=annotation)
            ):
                yield annotation
            case ast.keyword(arg="strict"):
                yield node.value
            case ast.Raise() | ast.Assert() | ast.JoinedStr() | ast.TypeAlias():
                yield node
            case ast.Import() | ast.ImportFrom():
                yield node
