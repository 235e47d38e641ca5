"""What a plug-in says of itself, and whether all that it imports is there, from its source: engines take seconds."""

import ast
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint
from importlib.util import find_spec, resolve_name
from pathlib import Path

BLOCKS = ("body", "orelse", "finalbody")


def summary_unloaded(entry_point: EntryPoint) -> str | None:
    """Return the one line that a plug-in says of itself.

    Returns:
        None where only loading it tells: it is not made by a call with a text for `summary`, something that it imports
        is not there, or its source cannot be read.
    """
    try:
        summary = _summary(_parsed(entry_point.module), entry_point.attr)
        return summary if summary is not None and _can_be_imported(entry_point.module, set()) else None
    except (ImportError, OSError, SyntaxError, ValueError):
        return None


def _summary(module: ast.Module, name: str) -> str | None:
    """Return the text for `summary` in `name = call(..., summary=text)`."""
    for statement in module.body:
        if not (isinstance(statement, ast.Assign) and isinstance(statement.value, ast.Call)):
            continue
        if [target.id for target in statement.targets if isinstance(target, ast.Name)] != [name]:
            continue
        for argument in statement.value.keywords:
            if argument.arg == "summary" and isinstance(argument.value, ast.Constant):
                return str(argument.value.value)
    return None


def _can_be_imported(name: str, asked: set[str]) -> bool:
    """Return whether all is there that a module of a plug-in imports, and what it imports of its own package.

    One that raises something when it is imported has more to say, and is.
    """
    if name in asked:
        return True
    asked.add(name)
    module = _parsed(name)
    if any(isinstance(node, ast.Raise) for node in _executed(module)):
        import_module(name)
    package = name.partition(".")[0]
    for other in _imports(name, module):
        if other.partition(".")[0] != package:
            if not _is_there(other.partition(".")[0]):
                return False
        elif not _can_be_imported(other, asked):
            return False
    return True


def _imports(name: str, module: ast.Module) -> Iterator[str]:
    parent = name if _is_package(name) else name.rpartition(".")[0]
    for node in _executed(module):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            other = resolve_name("." * node.level + (node.module or ""), parent)
            yield other
            if other.partition(".")[0] == name.partition(".")[0] and _is_package(other):
                modules = (f"{other}.{alias.name}" for alias in node.names)
                yield from (one for one in modules if find_spec(one) is not None)


def _executed(module: ast.Module) -> Iterator[ast.stmt]:
    """Yield the statements that are executed when a module is imported, whatever its conditions say."""
    waiting = list(module.body)
    while waiting:
        statement = waiting.pop()
        yield statement
        if isinstance(statement, ast.If) and "TYPE_CHECKING" in ast.dump(statement.test):
            continue
        if isinstance(statement, ast.If | ast.Try | ast.With | ast.For | ast.While):
            nested = [statement, *getattr(statement, "handlers", [])]
            waiting += (one for block in nested for part in BLOCKS for one in getattr(block, part, []))


def _is_there(package: str) -> bool:
    return package in sys.builtin_module_names or find_spec(package) is not None


def _parsed(name: str) -> ast.Module:
    return _parsed_file(_origin(name))


@cache
def _parsed_file(path: str) -> ast.Module:
    return ast.parse(Path(path).read_bytes())


def _is_package(name: str) -> bool:
    return Path(_origin(name)).stem == "__init__"


def _origin(name: str) -> str:
    """Return the source file of a module.

    Raises:
        ImportError: It has none.
    """
    spec = find_spec(name)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        raise ModuleNotFoundError(f"no source of {name}")
    return spec.origin
