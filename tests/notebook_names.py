"""Names and arguments that code of a notebook uses, without running it."""

import ast
import importlib
import inspect
import types


def find_faults(source):
    """Return what code asks of imported modules that is not there, and calls that do not fit.

    Modules that are not installed, as those that the notebook writes, are left out.
    """
    tree = ast.parse(source)
    values = {}
    faults = [fault for node in ast.walk(tree) for fault in _import(node, values)]
    # A name that is also assigned may be anything.
    assigned = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and not _is_read(n)}
    values = {name: value for name, value in values.items() if name not in assigned}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            value = _resolve(node.value, values)
            if isinstance(value, types.ModuleType | type) and not hasattr(value, node.attr):
                faults.append(f"{ast.unparse(node)}: is not there")
        elif isinstance(node, ast.Call):
            faults += _bind(node, _resolve(node.func, values))
    return faults


def _is_read(name):
    return isinstance(name.ctx, ast.Load)


def _import(node, values):
    if not isinstance(node, ast.Import | ast.ImportFrom):
        return
    for alias in node.names:
        name = alias.name if isinstance(node, ast.Import) else node.module
        try:
            module = importlib.import_module(name)
        except ImportError:
            if name.partition(".")[0] in ("angler_mjx", "angler_sitl", "angler_experiments"):
                yield f"import {name}: is not there"
            continue
        if isinstance(node, ast.Import):
            bound = alias.asname or name.partition(".")[0]
            values[bound] = module if alias.asname else importlib.import_module(bound)
            continue
        try:
            value = getattr(module, alias.name)
        except AttributeError:
            try:
                value = importlib.import_module(f"{name}.{alias.name}")
            except ImportError:
                yield f"from {name} import {alias.name}: is not there"
                continue
        values[alias.asname or alias.name] = value


def _resolve(node, values):
    """Return the object that names and attributes stand for, or None."""
    if isinstance(node, ast.Name):
        return values.get(node.id)
    if isinstance(node, ast.Attribute):
        return getattr(_resolve(node.value, values), node.attr, None)
    return None


def _bind(call, function):
    is_open = any(isinstance(argument, ast.Starred) for argument in call.args) or any(
        keyword.arg is None for keyword in call.keywords
    )
    if not callable(function) or is_open:
        return []
    try:
        signature = inspect.signature(function)
    except ValueError:  # a builtin without one
        return []
    try:
        signature.bind(*call.args, **{keyword.arg: None for keyword in call.keywords})
    except TypeError as error:
        return [f"{ast.unparse(call.func)}: {error}"]
    return []
