"""Run R on the random studies of tests/extras/study/analysis/designs.py: python -m tools.study.r_figures [FIRST LAST]

Needs R with car, emmeans, jsonlite, lme4 and pbkrtest (Debian: r-base-core and r-cran-NAME). Writes
tests/extras/study/analysis/data/r_figures.json, which tests use. All 200 take a quarter of an hour on an idle core; the
committed file has 136 of them.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from apps.progress import each
from glsplat.io.files import replace_file
from tests.extras.study.analysis.designs import COUNT, design

HERE = Path(__file__).parent
TARGET = HERE.parents[1] / "tests" / "extras" / "study" / "analysis" / "data" / "r_figures.json"
BATCH = 4


def figures(numbers: Iterable[int], folder: Path) -> dict[str, dict[str, dict[str, list[float]]]]:
    """Return R's results of some studies, by number."""
    paths = {number: folder / f"{number}.csv" for number in numbers}
    for number, path in paths.items():
        made = design(number)
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["participant", *made.factors, "y"])
            writer.writerows([name, *levels, "" if value is None else repr(value)] for name, levels, value in made.rows)
    subprocess.run(["Rscript", "--vanilla", str(HERE / "r_figures.R"), *map(str, paths.values())], check=True)
    said = {str(number): json.loads(path.with_suffix(".json").read_text()) for number, path in paths.items()}
    # R writes an empty list as [], not {}
    return {number: {kind: dict(rows) for kind, rows in kinds.items()} for number, kinds in said.items()}


def main(first: int = 0, last: int = COUNT) -> None:
    """Update the results of the studies from ``first`` to before ``last``."""
    known = json.loads(TARGET.read_text()) if TARGET.exists() else {}
    for begin in each(range(first, last, BATCH), "batches"):
        with tempfile.TemporaryDirectory() as folder:
            known |= figures(range(begin, min(begin + BATCH, last)), Path(folder))
        rows = [f"{json.dumps(number)}: {json.dumps(known[number])}" for number in sorted(known, key=int)]
        replace_file(TARGET, [("{\n" + ",\n".join(rows) + "\n}\n").encode()])


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
