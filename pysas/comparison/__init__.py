"""Methods side by side: each one's run time beside its error against `pysas.reference.exact`, as a table and a figure.

`methods` gives the calls that a data set allows, `compare` runs and judges them (or any others), `table` and `figure` show
what was found.
"""

from pysas.comparison.calls import TOLS, Call, methods
from pysas.comparison.panels import figure
from pysas.comparison.rows import Comparison, Pair, Row, front
from pysas.comparison.runs import compare
from pysas.comparison.text import table

__all__ = ["TOLS", "Call", "Comparison", "Pair", "Row", "compare", "figure", "front", "methods", "table"]
