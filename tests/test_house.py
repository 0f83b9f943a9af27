"""The house has one direction: a module imports modules below it, and none of them leads back to it.

Imports inside functions and those for type checkers alone count: what must know a type above it is in a circle.
"""

from __future__ import annotations

import pytest
from import_graph import GRAPH, MODULES, graph_of, imports, reach


def test_the_tree_is_read() -> None:
    assert {"pysas", "pysas.engine", "pysas.engine._numba", "pysas.reference.direct", "pysas.planner"} <= MODULES.keys()
    assert {"pysas.echoes", "pysas.grid"} <= GRAPH["pysas.reference.direct"]


def test_imports_are_found() -> None:
    text = "import a.b\nfrom c import d\ndef f():\n    from .. import e\n    from .g import h\n    import_module('k.l')"
    assert imports(text, "p.q.r") == {"a.b", "c.d", "p.e", "p.q.g.h", "k.l"}
    assert imports("from . import e", "p.q", packages={"p.q"}) == {"p.q.e"}
    assert imports("from p import f, e", "p.q", {"p.e"}) == {"p", "p.e"}
    assert reach("a", {"a": {"b"}, "b": {"c", "pysas"}, "c": {"a"}, "pysas": {"d"}}) == {"b", "c"}


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The strongly connected components of more than one module, but for the root package, which imports everything."""
    reached = {name: reach(name, graph) for name in graph}
    found = {tuple(sorted({name, *(n for n in names if name in reached.get(n, ()))})) for name, names in reached.items()}
    return sorted(list(names) for names in found if len(names) > 1)


def test_circles_are_found() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": {"d", "e"}, "e": {"f"}, "f": {"g"}, "g": {"e"}}
    assert circles(graph) == [["b", "c"], ["e", "f", "g"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
    late = {"p.a": "def f():\n    from p import b", "p.b": "if TYPE_CHECKING:\n    from p.a import C"}
    assert circles({name: imports(text, name, late) for name, text in late.items()}) == [["p.a", "p.b"]]


@pytest.mark.parametrize("package", ["pysas", "bench"])
def test_no_modules_import_each_other_round_a_corner(package: str) -> None:
    assert circles(graph_of(package)) == []
