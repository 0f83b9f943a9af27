"""The command line: one module a command, `program` that reads the arguments and runs them, `common` that they share."""

from pysas.cli.program import main, parser

__all__ = ["main", "parser"]
