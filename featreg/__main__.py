"""`python -m featreg` is the command line."""

import sys

from featreg.cli import main

sys.exit(main())
