"""`python -m maniskill_grpd COMMAND`, the same as `maniskill-grpd COMMAND`."""

import sys

from maniskill_grpd.commands import main

if __name__ == "__main__":
    sys.exit(main())
