"""`python -m pysas` is the command line."""

import sys

from pysas.cli import main

sys.exit(main())
