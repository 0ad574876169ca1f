"""Write all pages of docs/ that follow from committed data: `python -m tools.docs`, or `make docs`.

Nothing is measured here and nothing takes long. What the pages are made of is written by `benchmarks/*.py`,
`python -m tools.docs.measure_physics`, and studies; pictures of the tasks by `python -m tools.docs.task_gallery`, replays of them
and of the shipped checkpoints by `python -m tools.docs.replays`.
"""

from __future__ import annotations

import sys
from pathlib import Path

from maniskill_grpd.experiments.pages import write_study_page, write_summary_page
from maniskill_grpd.experiments.studies import STUDIES
from tools.docs.pages import DOCS, draw, pages


def main() -> None:
    """Write the pages and say which."""
    written: list[Path] = []
    for name, text in pages().items():
        (DOCS / name).write_text(text, encoding="utf-8")
        written.append(DOCS / name)
    draw()
    written += [write_study_page(study, DOCS / "results") for study in STUDIES.values()]
    written.append(write_summary_page(DOCS / "results"))
    sys.stdout.writelines(f"{path}\n" for path in written)


if __name__ == "__main__":
    main()
