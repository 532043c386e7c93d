"""`python -m tools` is `tagmill`."""

import sys

from tools.cli import main

sys.exit(main())
