"""The house has one direction: a module imports modules below it, and none of them leads back to it.

Imports inside functions and those for type checkers alone count: what must know a type above it is in a circle.
"""

from __future__ import annotations

import pytest
from import_graph import GRAPH, MODULES, ROOT, graph_of, imports, reach


def test_the_tree_is_read() -> None:
    assert {"pysas", "pysas.engine", "pysas.engine._numba", "pysas.reference.direct", "pysas.imaging.planner"} <= MODULES.keys()
    assert {"pysas.model.echoes", "pysas.model.grid"} <= GRAPH["pysas.reference.direct"]


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


def rooms(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The same by what stands directly under the package, itself apart."""

    def room(name: str) -> str:
        return ".".join(name.split(".")[:2])

    found: dict[str, set[str]] = {}
    for name, others in graph.items():
        if room(name) != "pysas":
            found.setdefault(room(name), set()).update({room(other) for other in others} - {room(name), "pysas"})
    return found


def test_no_rooms_import_each_other_round_a_corner() -> None:
    assert rooms({"pysas": {"pysas.a.b"}, "pysas.a.b": {"pysas.a.c", "pysas.d"}}) == {"pysas.a": {"pysas.d"}}
    assert circles(rooms(GRAPH)) == []


def test_a_newcomer_sees_few_doors() -> None:
    built = {"__pycache__", "include", "lib"}  # the C library's, beside an editable installation
    doors = {path.name for path in (ROOT / "pysas").iterdir() if path.is_dir() or path.suffix in (".py", ".typed")}
    assert len(doors - built) <= 23
