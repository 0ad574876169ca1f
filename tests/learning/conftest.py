"""Make the stand-ins beside the tests importable, also from subprocesses."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
