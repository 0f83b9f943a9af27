"""The sources of the checkout that the tests lie in, and who imports whom, for the tests of the architecture."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def modules(package: str) -> dict[str, str]:
    """Sources by dotted name."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path.read_text(encoding="utf-8")
        for path in sorted((ROOT / package).rglob("*.py"))
    }


MODULES = modules("pysas")
SCRIPTS = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for folder in ("bench", "examples")
    for path in sorted((ROOT / folder).rglob("*.py"))
}


def within(name: str, package: str | Iterable[str]) -> bool:
    """Whether a dotted name is a package (or one of several) or lies in it."""
    packages = (package,) if isinstance(package, str) else package
    return any(name == one or name.startswith(one + ".") for one in packages)


def imports(text: str, module: str = "pysas.x", modules: Iterable[str] = (), packages: Iterable[str] = ()) -> set[str]:
    """Dotted names a module imports anywhere; `from a import b` gives a.b where that is a module, else a.

    Without `modules` every `from a import b` gives a.b. Imports by importlib with a constant name count as well.
    """
    known = set(modules)
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = module.split(".") if module in packages else module.split(".")[:-1]
                parents = parents[: len(parents) - (node.level - 1)]
                base = ".".join([*parents, *([node.module] if node.module else [])])
            for alias in node.names:
                full = f"{base}.{alias.name}"
                found.add(full if not known or full in known else base)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__"):
            found.update(a.value for a in node.args[:1] if isinstance(a, ast.Constant) and isinstance(a.value, str))
    return found


def graph_of(package: str) -> dict[str, set[str]]:
    """What each module of a package in the tree imports of it, inside functions and for type checkers alone too."""
    found = modules(package)
    packages = {".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / package).rglob("__init__.py")}
    return {name: {i for i in imports(text, name, found, packages) if within(i, package)} for name, text in found.items()}


GRAPH = graph_of("pysas")


def reach(start: str, graph: dict[str, set[str]]) -> set[str]:
    """Modules that `start` imports, directly or not. The root package is not followed: it imports everything."""
    found: set[str] = set()
    left = [start]
    while left:
        for name in graph.get(left.pop(), set()) - found - {"pysas"}:
            found.add(name)
            left.append(name)
    return found - {start}
