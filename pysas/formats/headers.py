"""Headers in JSON (standard library) or YAML (PyYAML's safe loader, extra `yaml`): a mapping of plain values.

Text of others: at most 256 KiB are read, no alias is followed, a key that stands twice is an error.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pysas import _checks
from pysas.formats import files

SUFFIXES = (".yaml", ".yml", ".json")
MOST = 2**18  # bytes: seconds of PyYAML
_NUMBERS = (  # of YAML 1.2's core schema (10.3.2), decimal, and what they begin with
    ("tag:yaml.org,2002:int", re.compile(r"[-+]?[0-9]+$"), list("-+0123456789")),
    ("tag:yaml.org,2002:float", re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$"), list("-+.0123456789")),
)


def read_header(path: str) -> dict[str, Any]:
    """The mapping that a file holds.

    Raises
    ------
    ValueError
        More than 256 KiB, no UTF-8, no JSON or YAML, no mapping, a key twice; names the file.
    OSError, ImportError
        From the file system; YAML without PyYAML.
    """
    content = files.small(path, MOST, "a header")
    loads = json_of if Path(path).suffix.lower() == ".json" else _yaml_loads()
    try:
        value = loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        said = " ".join((str(error) or type(error).__name__).split())
        raise ValueError(f"{path}: {said:.200}") from None
    if not isinstance(value, dict):
        raise ValueError(f"{path}: found {type(value).__name__}, expected a mapping of keys to values")
    return value


def written_header(path: str, entries: Mapping[str, Any]) -> bytes:
    """The text of a header, in the format that the name of its file says."""
    try:
        text = json.dumps(entries, indent=2, ensure_ascii=False, allow_nan=False)
    except ValueError:
        raise ValueError(f"{path}: found a number that is not finite, expected such as a header can hold") from None
    if Path(path).suffix.lower() == ".json":
        return f"{text}\n".encode()
    yaml = _yaml()

    class Dumper(yaml.SafeDumper):  # type: ignore[misc, name-defined]
        def ignore_aliases(self, data: Any) -> bool:
            return True

    for tag, pattern, first in _NUMBERS:  # so that text that looks like a number is quoted
        Dumper.add_implicit_resolver(tag, pattern, first)
    made: str = yaml.dump(dict(entries), Dumper=Dumper, sort_keys=False, allow_unicode=True, width=120)
    return made.encode()


def json_of(text: str) -> Any:
    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"{twice:.60}: found twice, expected once")
        return found

    def finite(text: str) -> float:
        if not math.isfinite(value := float(text)):
            raise ValueError(f"found {text:.60}, expected finite numbers")
        return value

    return json.loads(text, object_pairs_hook=once, parse_constant=finite, parse_float=finite)


def _yaml_loads() -> Any:
    """A loader of YAML without aliases and dates, whose numbers are those of YAML 1.2 (1e5 is a number, 1_000 is none)."""
    yaml = _yaml()

    class Loader(yaml.SafeLoader):  # type: ignore[misc, name-defined]
        yaml_implicit_resolvers = {
            first: [(tag, pattern) for tag, pattern in known if tag.rpartition(":")[2] in ("bool", "null")]
            for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
        }

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise ValueError(f"found an alias, expected plain values{self.peek_event().start_mark}")
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            found = super().construct_mapping(node, deep=True)
            if len(found) < len(node.value):
                raise ValueError(f"found a key twice, expected each once{node.start_mark}")
            if not all(isinstance(key, str) for key in found):
                raise ValueError(f"found a key that is no text{node.start_mark}")
            return found

        def construct_yaml_float(self, node: Any) -> float:
            if not math.isfinite(value := float(self.construct_scalar(node))):
                raise ValueError(f"found {node.value:.60}, expected finite numbers{node.start_mark}")
            return value

        def construct_yaml_int(self, node: Any) -> int:
            return int(self.construct_scalar(node))

    for tag, pattern, first in _NUMBERS:
        Loader.add_implicit_resolver(tag, pattern, first)
    Loader.add_constructor("tag:yaml.org,2002:float", Loader.construct_yaml_float)
    Loader.add_constructor("tag:yaml.org,2002:int", Loader.construct_yaml_int)

    def loads(text: str) -> Any:
        try:
            return yaml.load(text, Loader)
        except yaml.YAMLError as error:
            raise ValueError(f"no YAML: {error}") from None

    return loads


def _yaml() -> Any:
    try:
        import yaml
    except ImportError:
        missing = _checks.optional("PyYAML", "yaml")
        raise ImportError(f"{missing}; a header in JSON needs nothing") from None
    return yaml
