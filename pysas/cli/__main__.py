"""`python -m pysas.cli` is the command line, as `python -m pysas` is."""

import sys

from pysas.cli import main

sys.exit(main())
