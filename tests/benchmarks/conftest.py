"""Make the benchmarks importable, behind the scripts of `baselines`: both have a `train`."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
