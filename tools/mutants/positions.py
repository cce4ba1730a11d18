"""Positions of possible faults, and a random sample of them."""

import ast
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator

from tools.mutants.mutant import Mutant, build_mutant
from tools.mutants.operators import build_families

_TRIES = 20
"""Number of faults sampled at a position until one of them is valid Python and changes the code."""


@dataclass(frozen=True, kw_only=True)
class _CodePosition:
    file: str
    family: str
    start: tuple[int, int]
    choices: tuple[tuple[str, int], ...]
    """Operators, and the index of the occurrence in the file."""


def sample_mutants(root: Path, folders: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Sample mutants at ``count`` positions, all equally likely; one at each.

    Args:
        root: root of the tree.
        folders: folders of the mutated modules, from the root.
        count: number of mutants; all positions in random order if there are fewer.
        seed: seed of the sample.
    """
    operators = build_families()
    positions = [
        position
        for folder in folders
        for file in sorted((root / folder).rglob("*.py"))
        for position in _find_positions(
            operators, file.relative_to(root).as_posix(), file.read_text()
        )
    ]
    rng = random.Random(seed)
    rng.shuffle(positions)
    operators_by_name = {
        name: operator for family in operators.values() for name, operator in family.items()
    }
    mutants: list[Mutant] = []
    for position in positions:
        if len(mutants) == count:
            break
        mutant = _make_mutant(operators_by_name, root, position, rng)
        if mutant is not None:
            mutants.append(mutant)
    return mutants


def _find_positions(
    operators: dict[str, dict[str, Operator]], file: str, code: str
) -> Iterator[_CodePosition]:
    """Yield all positions of a file, in the order of operators' families and then of the file."""
    nodes = list(ast_nodes(get_ast(code)))
    # The bare stars and slashes of parameters are no products: a call by name is the same.
    bare_nodes = [
        node for node in nodes if node.type == "operator" and node.parent.type == "parameters"
    ]
    spared_ranges = [*_find_spared(code), *((node.start_pos, node.end_pos) for node in bare_nodes)]
    for family, family_operators in operators.items():
        choices_by_start: dict[tuple[int, int], list[tuple[str, int]]] = {}
        for name, operator in family_operators.items():
            starts = (start for node in nodes for start, _ in operator.mutation_positions(node))
            for occurrence, start in enumerate(starts):
                choices_by_start.setdefault(start, []).append((name, occurrence))
        for start, choices in sorted(choices_by_start.items()):
            if not any(low <= start < high for low, high in spared_ranges):
                yield _CodePosition(file=file, family=family, start=start, choices=tuple(choices))


def _make_mutant(
    operators_by_name: dict[str, Operator], root: Path, position: _CodePosition, rng: random.Random
) -> Mutant | None:
    before = (root / position.file).read_text()
    for _ in range(_TRIES):
        operator, occurrence = rng.choice(position.choices)
        after = mutate_code(before, operators_by_name[operator], occurrence)
        if after is None or not _is_other_python(before, after):
            continue
        return build_mutant(
            file=position.file,
            before=before,
            after=after,
            line=position.start[0],
            operator=operator,
            fault=str(occurrence),
        )
    return None


def _is_other_python(before: str, after: str) -> bool:
    try:
        return ast.dump(ast.parse(before)) != ast.dump(ast.parse(after))
    except SyntaxError:
        return False


def _find_spared(code: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return spared ranges, from (line, column) up to before another, that no test should judge.

    Annotations, decorators, imports, raised exceptions and their messages, formatted text,
    ``__repr__``, aliases of types, asserts, and ``strict=`` of ``zip``, which only guards against
    ourselves.
    """
    lines = code.splitlines(keepends=True)

    def to_characters(line: int, column: int) -> tuple[int, int]:
        """Convert a byte column of Python into a character column of Cosmic Ray."""
        return line, len(lines[line - 1].encode()[:column].decode())

    return [
        (
            to_characters(node.lineno, node.col_offset),
            to_characters(node.end_lineno, node.end_col_offset),
        )
        for node in _iterate_unjudged(ast.parse(code))
        if node.end_lineno is not None and node.end_col_offset is not None
    ]


def _iterate_unjudged(tree: ast.Module) -> Iterator[ast.expr | ast.stmt]:
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
