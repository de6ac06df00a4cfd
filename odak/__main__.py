"""Run the command line as ``python -m odak``."""

import sys

from odak.cli import main

if __name__ == "__main__":
    sys.exit(main())
