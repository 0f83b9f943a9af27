"""The rules between the layers, read from the sources: a change that breaks one fails here with the rule's name.

Each rule is a function from source text to complaints, tested on a snippet that breaks it and then on the tree. The
tree is the checkout the tests lie in, not the installed package.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from import_graph import GRAPH, MODULES, ROOT, SCRIPTS, imports, reach, within

import pysas

pytestmark = pytest.mark.reference  # no engine takes part

DATA_MODEL = {"pysas._checks"} | {name for name in MODULES if within(name, "pysas.model")}
TOOLS = {"pysas._pool", "pysas._pool.leaving"}  # threads for any loop: without NumPy, so without a delay
STRIPS = {"pysas.survey.strips", "pysas.survey.pings"}  # of a survey what sums; the rest of it keeps stores
EDGE = {"pysas", "pysas.loading", "pysas.plot", "pysas.__main__", "pysas.tracks"} | {
    name for name in MODULES if within(name, ("pysas.formats", "pysas.cli", "pysas.survey")) and name not in STRIPS
}
ALGORITHMS = MODULES.keys() - DATA_MODEL - TOOLS - EDGE
ENGINE_SIDE = ("pysas.engine", "pysas.planning", "pysas.imaging")
INDEPENDENT = ("pysas.reference", "pysas.circular")
OPTIONAL = {
    "matplotlib",
    "h5py",
    "xarray",
    "finufft",
    "zarr",
    "dask",
    "distributed",
    "rasterio",
    "pyproj",
    "google_crc32c",
    "sarkit",
    "lxml",
    "yaml",
}
# public without standing in pysas.__all__: importing it needs an optional library
PUBLIC_MODULES = {"plot"}
PUBLIC_FUNCTIONS = {
    "backproject", "ffbp", "focus", "plan", "simulate", "compress", "demodulate", "load", "load_echoes", "load_image", "save",
    "from_phase_history", "show_config", "get_include", "get_library", "inspect", "read_table", "align_points", "autofocus",
    "open_echoes", "follow", "mosaic", "overview", "page", "resume", "run", "verify",
}  # fmt: skip


# Rules 1 and 2: C++


def code_of(text: str) -> str:
    """C++ without comments and without what stands in quotes; #include lines stay whole."""
    text = re.sub(r"//[^\n]*|/\*.*?\*/", " ", text, flags=re.DOTALL)
    return "\n".join(
        line if line.lstrip().startswith("#include") else re.sub(r'"(\\.|[^"\\])*"', '""', line) for line in text.splitlines()
    )


def python_in(text: str) -> list[str]:
    return re.findall(r"#include.*(?:Python\.h|pybind11|numpy/).*|\bpybind11::\w+|\bPyObject\b", code_of(text))


def loops_in(text: str) -> list[str]:
    return re.findall(r"\b(?:for|while|do|goto|for_each|transform|accumulate)\b", code_of(text))


def allocations_in(text: str) -> list[str]:
    return re.findall(
        r"\bnew\b|\b(?:m|c|re)alloc\b|\bstd::(?:vector|string|map|set|deque|list|unordered_\w+|function|\w+_ptr|array)\b",
        code_of(text),
    )


def sources(*folders: str) -> dict[str, str]:
    return {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for folder in folders
        for path in sorted((ROOT / "csrc" / folder).rglob("*"))
        if path.is_file()
    }


def test_core_knows_no_python() -> None:
    for bad in ("#include <Python.h>", '#include "pybind11/numpy.h"', "pybind11::object x;"):
        assert python_in(bad)
    assert not python_in("// no pybind11 here\n#include <cstdint>\n")
    core = sources("include", "planning", "core", "kernels", "isa", "tests")
    assert core
    assert {name: found for name, text in core.items() if (found := python_in(text))} == {}


def test_bindings_do_no_arithmetic() -> None:
    assert loops_in("for (int i = 0; i < n; ++i) sum += x[i];") and loops_in("while(n--);")
    assert not loops_in('m.def("f", &f, "Waits for a while.");  // for ever')
    bind = sources("bind")
    assert bind
    assert {name: found for name, text in bind.items() if (found := loops_in(text))} == {}


def test_kernels_allocate_nothing() -> None:
    for bad in ("std::vector<float> x(n);", "float* x = new float[n];", "void* p = malloc(n);"):
        assert allocations_in(bad)
    assert not allocations_in("// a new one\nstatic inline float f(float x) { return std::sqrt(x); }")
    kernels = {name: text for name, text in sources("kernels").items() if name.endswith(".inl")}
    assert {name: found for name, text in kernels.items() if (found := allocations_in(text))} == {}


def gil_releases(text: str) -> list[str]:
    """What releases the GIL other than `Released`, whose threads stay outside while the interpreter ends."""
    others = re.sub(r"\bclass Released \{.*?\n\};", "", code_of(text), flags=re.DOTALL)
    return re.findall(r"\bgil_scoped_release\b|\bPyEval_SaveThread\b|\bPy_BEGIN_ALLOW_THREADS\b", others)


def test_the_gil_is_released_in_one_way() -> None:
    assert gil_releases("const py::gil_scoped_release gil;") and gil_releases("state_ = PyEval_SaveThread();")
    assert not gil_releases("class Released {\n    Released() { state_ = PyEval_SaveThread(); }\n};\nconst Released gil;")
    bind = sources("bind")
    assert any("class Released {" in text for text in bind.values())
    assert {name: found for name, text in bind.items() if (found := gil_releases(text))} == {}


UNSAFE = re.compile(r"ffast-math|funsafe-math|Ofast|march=native|mcpu=native|fp:fast|float_control|GCC\s+optimize")


def test_no_flag_changes_arithmetic_or_ties_the_build_to_this_machine() -> None:
    assert UNSAFE.search('FLAGS = ["-O3", "-ffast-math"]') and UNSAFE.search("CXXFLAGS += -march=native")
    files = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("setup.py", "pyproject.toml", "Makefile")}
    files |= sources(".")
    assert {name: found for name, text in files.items() if (found := UNSAFE.findall(text))} == {}


def numba_misuse(text: str) -> list[str]:
    """Keywords of @njit that flush subnormals' meaning (all of fastmath) or start threads nobody can interrupt."""
    return [
        ast.unparse(keyword)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call)
        for keyword in node.keywords
        if keyword.arg in ("fastmath", "parallel") and isinstance(keyword.value, ast.Constant) and keyword.value.value is True
    ]


def test_numba_kernels_keep_ieee_arithmetic_and_leave_threads_to_the_caller() -> None:
    assert numba_misuse("@njit(fastmath=True)\ndef f(): ...") == ["fastmath=True"]
    assert numba_misuse("@njit(parallel=True)\ndef f(): ...") == ["parallel=True"]
    assert {name: found for name, text in MODULES.items() if (found := numba_misuse(text))} == {}


def direct_calls(text: str) -> list[str]:
    """Calls of Numba kernels from outside such: Ctrl-C waits for the compiler then, and a fork's child for its lock."""
    tree = ast.parse(text)
    kernels = {
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(d) for d in node.decorator_list)
    }
    names = {node.name for node in kernels}
    found, left = [], [tree]
    while left:
        node = left.pop()
        left += [child for child in ast.iter_child_nodes(node) if child not in kernels]
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in names or re.search(r"(?:^|\.)_numba\w*\.\w+$", name):
                found.append(name)
    return found


def test_numba_kernels_are_entered_through_the_pool() -> None:
    assert direct_calls("@njit\ndef k(x): ...\ndef f():\n    k(1)") == ["k"]
    assert direct_calls("_numba.k(1)") == ["_numba.k"] and direct_calls("pysas.engine._numba_tree.leaf(2)")
    assert not direct_calls("@njit\ndef k(x): ...\n@njit(nogil=True)\ndef g():\n    k(1)\npool.call(k, 1)\n_numba.K + 1")
    assert {name: found for name, text in MODULES.items() if (found := direct_calls(text))} == {}


# Rule 3: one door to compiled code, one place for tol


COMPILED = {"_core", "_numba", "_numba_arcs", "_numba_reach", "_numba_samples", "_numba_tree"}


def compiled_imports(text: str) -> set[str]:
    return {name for name in imports(text) if COMPILED & set(name.split("."))}


def test_only_the_engine_imports_compiled_code() -> None:
    assert compiled_imports("from pysas.engine import _numba") and compiled_imports("import pysas.engine._core")
    assert compiled_imports("from pysas.engine._numba import BLOCK")
    outside = {name: text for name, text in MODULES.items() if not within(name, "pysas.engine")}
    assert {name: found for name, text in outside.items() if (found := compiled_imports(text))} == {}


def test_numba_s_engine_is_the_same_with_the_extension_and_without() -> None:
    """On this .ci/run relies where it leaves tests marked `numba` to the installation that has both."""
    assert {name for name, found in GRAPH.items() if "pysas.engine.native" in found} == {"pysas.engine", "pysas.engine.cpp"}
    assert {name for name, found in GRAPH.items() if "pysas.engine.cpp" in found} == {"pysas.engine"}
    asking = {
        node.name: set(re.findall(r"native\.\w+", ast.unparse(node)))
        for node in ast.walk(ast.parse(MODULES["pysas.engine"]))
        if isinstance(node, ast.FunctionDef)
    }
    assert {name: asked for name, asked in asking.items() if asked} == {
        "backend_name": {"native.extension", "native.absence"},
        "engine_of": {"native.warn_of_numba"},  # and no more: which engine it is, `backend_name` says
        "show_config": {"native.extension", "native.absence"},
    }


def engines_compared(text: str) -> list[str]:
    """Comparisons with an engine's name."""
    return [
        ast.unparse(node)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Compare) and {"cpp", "numba"} & {getattr(part, "value", None) for part in ast.walk(node)}
    ]


def test_nobody_asks_for_an_engine_s_name() -> None:
    for bad in ('x = 1 if backend == "cpp" else 2', 'if plan.backend in ("numba", "cuda"): ...'):
        assert engines_compared(bad)
    outside = {name: text for name, text in MODULES.items() if not within(name, "pysas.engine")}
    assert {name: found for name, text in outside.items() if (found := engines_compared(text))} == {}


def names_in(text: str) -> set[str]:
    """Every identifier: variables, arguments, keywords, attributes, fields."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        for field in ("id", "arg", "attr", "name"):
            value = getattr(node, field, None)
            if isinstance(value, str):
                found.add(value)
    return found


def test_the_engine_does_not_know_tol() -> None:
    for bad in ("def f(tol): ...", "f(tol=1)", "x = plan.tol", "tol = 1"):
        assert "tol" in names_in(bad)
    engine = {name: text for name, text in MODULES.items() if within(name, "pysas.engine")}
    planning = {"pysas.engine.interface", "pysas.engine.cpp"}  # which hand it to the planner in C++
    assert [name for name, text in engine.items() if "tol" in names_in(text) and name not in planning] == []
    assert [name for name, text in sources("core", "kernels").items() if re.search(r"\btol\b", code_of(text))] == []


def computed_tol(text: str) -> list[str]:
    """Arithmetic, comparisons and function calls of mathematics on a name or attribute `tol`."""

    def is_tol(node: ast.AST) -> bool:
        return (isinstance(node, ast.Name) and node.id == "tol") or (isinstance(node, ast.Attribute) and node.attr == "tol")

    found = []
    for node in ast.walk(ast.parse(text)):
        operands: list[ast.expr] = []
        if isinstance(node, ast.BinOp):
            operands = [node.left, node.right]
        elif isinstance(node, ast.UnaryOp):
            operands = [node.operand]
        elif isinstance(node, ast.Compare) and not isinstance(node.ops[0], ast.Is | ast.IsNot):
            operands = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[0] in ("np", "math"):
            operands = node.args
        found += [ast.unparse(node) for operand in operands if is_tol(operand)]
    return found


def test_only_planners_turn_tol_into_choices() -> None:
    """One of those settings that are searched for, one of the fixed ones."""
    for bad in ("n = 1 / tol", "if plan.tol < 1e-5: ...", "k = np.log10(tol)", "x = -tol"):
        assert computed_tol(bad)
    assert not computed_tol("plan(echoes, tol)\nif tol is None: ...\ntext = f'{tol:g}'")
    planners = {"pysas.imaging.planner", "pysas.planning.fallback.planner", "pysas.planning.fallback.trees"}
    others = {name: text for name, text in MODULES.items() if name not in planners}
    assert {name: found for name, text in others.items() if (found := computed_tol(text))} == {}


def clashes(modules: Iterable[str], public: Iterable[str]) -> set[str]:
    return {name for name in modules if name.split(".")[-1] in set(public)}


def test_no_module_bears_the_name_of_a_public_function() -> None:
    assert clashes(["pysas.backproject", "pysas.model.grid"], PUBLIC_FUNCTIONS) == {"pysas.backproject"}
    callables = {name for name in pysas.__all__ if callable(getattr(pysas, name))}
    assert clashes(MODULES, PUBLIC_FUNCTIONS | callables) == set()


# Rule 4: the references are independent


@pytest.mark.parametrize("module", [name for name in MODULES if within(name, INDEPENDENT)])
def test_references_import_no_engine(module: str) -> None:
    assert {name for name in reach(module, GRAPH) if within(name, ENGINE_SIDE)} == set()


def test_an_engine_behind_another_module_is_found() -> None:
    graph = {"pysas.reference.a": {"pysas.b"}, "pysas.b": {"pysas.engine.pool"}}
    assert within("pysas.engine.pool", ENGINE_SIDE) and "pysas.engine.pool" in reach("pysas.reference.a", graph)


def test_the_oracle_imports_only_the_data_model() -> None:
    assert GRAPH["pysas.reference.direct"] <= {"pysas.model.echoes", "pysas.model.grid", "pysas.model.image"}
    assert reach("pysas.reference.direct", GRAPH) <= DATA_MODEL


def shared(first: str, second: str, graph: dict[str, set[str]]) -> set[str]:
    """Modules that two packages both rely on, or that one of them has of the other."""

    def all_of(package: str) -> set[str]:
        members = {name for name in graph if within(name, package)}
        return members | {name for member in members for name in reach(member, graph)}

    return all_of(first) & all_of(second)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("pysas.signal.simulation", "pysas.reference.direct"),
        ("pysas.signal.simulation", "pysas.engine"),
        ("pysas.reference.direct", "pysas.engine"),
    ],
)
def test_simulator_oracle_and_engine_share_no_delay_code(first: str, second: str) -> None:
    assert shared(first, second, GRAPH) <= DATA_MODEL | TOOLS


def test_tools_compute_nothing() -> None:
    assert {name: found for name in TOOLS if (found := {"numpy", "numba", "math"} & imports(MODULES[name]))} == {}


def test_shared_code_is_found() -> None:
    graph = {"pysas.a": {"pysas.delays"}, "pysas.b.c": {"pysas.delays"}, "pysas.delays": set(), "pysas.d": {"pysas.a"}}
    assert shared("pysas.a", "pysas.b", graph) == {"pysas.delays"}
    assert shared("pysas.a", "pysas.d", graph) == {"pysas.a", "pysas.delays"}


# Rule 5: files at the edge, optional libraries where they are used


def test_files_know_no_algorithm_and_algorithms_no_file() -> None:
    assert {"pysas.imaging.planner", "pysas.engine._numba"} <= ALGORITHMS
    for door in ("pysas.formats.io", "pysas.formats.catalogue"):
        assert reach(door, GRAPH) & ALGORITHMS == set()
    assert {name for name in ALGORITHMS | DATA_MODEL if "pysas.formats.io" in reach(name, GRAPH)} == set()


def file_access(text: str) -> list[str]:
    found = [name for name in imports(text) if name.split(".")[0] in ("pathlib", "io", "h5py", "tempfile", "shutil")]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name == "open" or re.fullmatch(r"np\.(load|save|savez\w*|loadtxt|savetxt|fromfile|memmap|genfromtxt)", name):
                found.append(name)
    return found


def test_algorithms_open_no_file() -> None:
    for bad in ("open('x')", "np.load('x')", "from pathlib import Path", "def f():\n    import h5py"):
        assert file_access(bad)
    inner = {name: MODULES[name] for name in ALGORITHMS | DATA_MODEL}
    assert {name: found for name, text in inner.items() if (found := file_access(text))} == {}


def on_import(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes that run when a module is imported: bodies of functions and of `if TYPE_CHECKING` do not."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.If) and ast.unparse(child.test).split(".")[-1] == "TYPE_CHECKING":
            continue
        yield child
        yield from on_import(child)


def optional_imports(text: str) -> set[str]:
    body = [node for node in on_import(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom)]
    return {name for node in body for name in imports(ast.unparse(node)) if name.split(".")[0] in OPTIONAL}


def test_optional_libraries_are_imported_where_they_are_used() -> None:
    for bad in (
        "import h5py",
        "try:\n    import xarray as xr\nexcept ImportError:\n    xr = None",
        "from matplotlib import pyplot",
    ):
        assert optional_imports(bad)
    assert not optional_imports("def f():\n    import h5py\nif TYPE_CHECKING:\n    import xarray\n")
    assert {name: found for name, text in MODULES.items() if (found := optional_imports(text))} == {}


# Rule 6: benchmarks and examples use the public API


def private_use(text: str, public: set[str]) -> set[str]:
    """Names of pysas, imported or reached by attribute, that are not public or lead through something private."""

    def hidden(parts: list[str]) -> bool:
        return bool(parts) and (parts[0] not in public or any(re.match(r"_(?!_)", part) for part in parts))

    found = {name for name in imports(text) if within(name, "pysas") and hidden(name.split(".")[1:])}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and re.fullmatch(r"pysas(\.\w+)+", chain := ast.unparse(node)):
            if hidden(chain.split(".")[1:]):
                found.add(chain)
    return found


def test_benchmarks_and_examples_use_the_public_api_alone() -> None:
    public = set(pysas.__all__) | PUBLIC_MODULES | {"__version__"}
    for bad in (
        "from pysas.engine import summation",
        "import pysas.imaging.planner",
        "from pysas import _checks",
        "pysas.engine.pool()",
    ):
        assert private_use(bad, {"plan", "reference"})
    assert not private_use("import pysas\nfrom pysas import plan\npysas.reference.exact()", {"plan", "reference"})
    assert SCRIPTS
    assert {name: found for name, text in SCRIPTS.items() if (found := private_use(text, public))} == {}


# Tests of the references alone, which the run without the extension leaves out


def engine_use(text: str) -> set[str]:
    return set(re.findall(r"\b(?:backproject|backproject_arrays|ffbp|focus|plan)(?=\()|pysas\.engine", text))


def test_reference_tests_call_no_engine() -> None:
    assert engine_use("image = pysas.ffbp(echoes, grid)") == {"ffbp"}
    marked = {
        path.name: text
        for path in (ROOT / "tests").glob("*.py")
        if "pytestmark = pytest.mark.reference" in (text := path.read_text(encoding="utf-8"))
        and path.name != Path(__file__).name
    }
    assert marked
    assert {name: found for name, text in marked.items() if (found := engine_use(text))} == {}


# Errors: input never meets an `assert`, which says nothing, and nothing at all under python -O


def assertions(text: str) -> list[str]:
    return [ast.unparse(node) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Assert)]


def test_what_cannot_be_is_an_internal_error() -> None:
    assert assertions("def f(x):\n    assert x > 0") == ["assert x > 0"]
    assert {name: found for name, text in MODULES.items() if (found := assertions(text))} == {}


# Size: what is longer than this holds more than one thing

LONGEST = 500


def test_modules_stay_short() -> None:
    files = MODULES | SCRIPTS | sources(".")
    assert {name: lines for name, text in files.items() if (lines := len(text.splitlines())) > LONGEST} == {}


def test_the_package_file_holds_public_names_and_nothing_else() -> None:
    body = ast.parse(MODULES["pysas"]).body
    allowed = (ast.Import, ast.ImportFrom, ast.Assign, ast.AnnAssign)
    cases = {ast.unparse(node.test): node for node in body if isinstance(node, ast.If)}
    assert set(cases) == {"TYPE_CHECKING", "not TYPE_CHECKING"}
    lazily = [node for node in body + cases["not TYPE_CHECKING"].body if isinstance(node, ast.FunctionDef)]
    assert {node.name for node in lazily} == {"__getattr__", "__dir__"}
    typed = cases["TYPE_CHECKING"].body
    assert all(isinstance(node, ast.ImportFrom) for node in typed)
    homes = {(node.module, alias.name) for node in typed for alias in node.names if node.module != "pysas"}
    in_rooms = {(f"pysas.{place.removesuffix(f'.{name}')}", name) for name, place in pysas._ROOM_OF.items()}
    assert homes == {(f"pysas.{module}", name) for name, module in pysas._MODULE_OF.items()} | in_rooms
    body = [node for node in body if node not in [*lazily, *cases.values()]]
    body = body[1:] if ast.get_docstring(ast.parse(MODULES["pysas"])) else body
    assert [ast.unparse(node) for node in body if not isinstance(node, allowed)] == []
