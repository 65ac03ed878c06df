"""`python -m facts_damping`: the command line."""

import sys

from facts_damping.cli.main import main

sys.exit(main())
