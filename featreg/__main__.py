"""`python -m featreg` is the command line."""

import sys

from featreg.cli.main import main

sys.exit(main())
