"""`python -m stillflux`: the command line."""

import sys

from stillflux.cli import main

if __name__ == "__main__":
    sys.exit(main())
