"""XML of the radar standards CPHD and SICD: parsed without entities, and held against its schema before it is used."""

from __future__ import annotations

import contextlib
import importlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray

SPEED = 299792458.0  # of light, m/s
_MOST = 2**26  # bytes of XML


class Metadata:
    """The XML of a file.

    Parameters
    ----------
    content : bytes
        UTF-8.
    versions : mapping
        Of `sarkit`: namespaces and where their schemas are.

    Raises
    ------
    ValueError
        No XML, one that declares a document type (entities among them), one of another namespace or that its schema refuses.
    """

    def __init__(self, content: bytes, versions: Any) -> None:
        etree = library("lxml.etree")
        if len(content) > _MOST:
            raise ValueError(f"XML: found {len(content)} bytes: expected at most {_MOST}")
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
        try:
            self.tree = etree.fromstring(content, parser).getroottree()
        except etree.XMLSyntaxError as error:
            raise ValueError(f"XML: {error}") from None
        if self.tree.docinfo.doctype or self.tree.docinfo.internalDTD is not None:
            raise ValueError("XML: found a document type: expected none")
        name = etree.QName(self.tree.getroot())
        if name.namespace not in versions:
            known = ", ".join(str(version["version"]) for version in versions.values())
            raise ValueError(f"XML: found {name.namespace!r:.60}: expected one of versions {known}")
        self.version = str(versions[name.namespace]["version"])
        schema = etree.XMLSchema(file=str(versions[name.namespace]["schema"]))
        if not schema.validate(self.tree):
            first = schema.error_log[0]
            raise ValueError(f"XML: line {first.line}: {first.message:.300}")
        self.text = content.decode("utf-8")

    def all(self, path: str) -> list[Any]:
        """Elements on a path of names, without namespaces."""
        return list(self.tree.findall("/".join(f"{{*}}{part}" for part in path.split("/"))))

    def find(self, path: str, among: Any = None) -> str | None:
        """Text of the first element on a path, from the root or one of its elements, or None."""
        found = (self.tree if among is None else among).findtext("/".join(f"{{*}}{part}" for part in path.split("/")))
        return None if found is None else str(found).strip()

    def get(self, path: str, among: Any = None) -> str:
        """As `find`; ValueError where there is none."""
        found = self.find(path, among)
        if found is None:
            raise ValueError(f"XML: {path}: missing")
        return found

    def number(self, path: str, among: Any = None) -> float:
        """A finite number."""
        text = self.get(path, among)
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ValueError(f"XML: {path}: found {text!r:.60}: expected a finite number")
        return value

    def whole(self, path: str, among: Any = None, low: int = 0) -> int:
        """A whole number, at least `low`."""
        text = self.get(path, among)
        if not (text.isascii() and text.isdigit() and len(text) < 16 and int(text) >= low):
            raise ValueError(f"XML: {path}: found {text!r:.60}: expected a whole number >= {low}")
        return int(text)

    def vector(self, path: str, parts: Sequence[str] = "XYZ") -> FloatArray:
        """Numbers of the parts X, Y and Z of an element, or of others."""
        return np.array([self.number(f"{path}/{part}") for part in parts])


def library(name: str) -> Any:
    """A module of `sarkit`, or of what it needs."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise _checks.optional("sarkit", "radar") from None


def axes(x: npt.ArrayLike, y: npt.ArrayLike, what: str) -> FloatArray:
    """Unit vectors (3, 3) along `x`, `y` and upwards from both, which are at right angles and of length 1."""
    both = np.array([x, y], dtype=np.float64)
    if np.abs(both @ both.T - np.eye(2)).max() > 1e-6:
        raise ValueError(f"XML: {what}: expected two unit vectors at right angles")
    across = np.cross(both[0], both[1])
    first = both[0] / np.linalg.norm(both[0])
    third = across / np.linalg.norm(across)
    return np.stack([first, np.cross(third, first), third])


def require_place(position: FloatArray, geodetic: FloatArray, what: str) -> None:
    """Raise where the Earth-fixed and the geodetic coordinates (degrees, m) of a place are those of two."""
    there = library("sarkit.wgs84").geodetic_to_cartesian(geodetic)
    apart = float(np.linalg.norm(position - there))
    if not apart < 10.0:
        raise ValueError(f"XML: {what}: its Earth-fixed and geodetic coordinates are {apart:.4g} m apart")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings of `sarkit` about Python's own library."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        yield


def placed(ecef: Mapping[str, Any] | None) -> tuple[FloatArray, FloatArray]:
    """Origin (3,) and axes (3, 3) of coordinates on the Earth; None: east, north and up at latitude 0, longitude 0."""
    if ecef is None:
        return np.array([6378137.0, 0.0, 0.0]), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    if not isinstance(ecef, Mapping) or not {"origin", "axes"} <= set(ecef):
        raise ValueError('ecef: expected {"origin": (3,), "axes": (3, 3)}')
    origin, turn = _checks.reals("ecef origin", ecef["origin"], [(3,)]), _checks.reals("ecef axes", ecef["axes"], [(3, 3)])
    if np.abs(turn - axes(turn[0], turn[1], "ecef")).max() > 1e-6:
        raise ValueError("ecef: axes: expected right-handed unit vectors at right angles")
    return origin, turn


def xyz(values: npt.ArrayLike) -> dict[str, Any]:
    """The content of an element of three numbers."""
    return dict(zip("XYZ", np.asarray(values, dtype=np.float64).tolist(), strict=True))


def made(namespace: str, name: str, content: Mapping[str, Any]) -> Any:
    """A tree of XML: attributes (@name), text ("") and elements, lists of those of a name, in the order of `content`."""
    root = library("lxml.etree").Element(f"{{{namespace}}}{name}", nsmap={None: namespace})
    _fill(root, content, namespace)
    return root.getroottree()


def _fill(element: Any, content: Mapping[str, Any], namespace: str) -> None:
    for name, value in content.items():
        if name.startswith("@"):
            element.set(name[1:], str(value))
        elif name == "":
            element.text = str(value)
        else:
            for item in value if isinstance(value, list) else [value]:
                child = element.makeelement(f"{{{namespace}}}{name}")
                element.append(child)
                if isinstance(item, Mapping):
                    _fill(child, item, namespace)
                else:
                    child.text = str(item)
