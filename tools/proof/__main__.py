"""``python -m tools.proof [--out DIR] [--trainer PYTHON]``."""

import sys

from tools.proof.run import main

if __name__ == "__main__":
    sys.exit(main())
