"""Write docs/measured/evaluation.md, whose tables docs/evaluation.md shows, from an evaluation of 24 people.

glsplat evaluate --participants DIR -o OUT
python -m tools.docs.evaluation_results OUT
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from glsplat.io.files import replace_file
from tools.docs.measured import FOLDER, Table, page_of, table_of

MEASURES = {"l1": "L1", "lpips": "LPIPS", "psnr": "PSNR", "ssim": "SSIM"}
CONTROLS = {"tracking": "head and hands", "pose": "the true pose"}


def text(spread: Mapping[str, Any], name: str, deviation: bool = True) -> str:
    """Return a mean and its deviation as a table's cell."""
    digits = 1 if name == "psnr" else 3
    mean = f"{spread['mean']:.{digits}f}"
    return f"{mean} ({spread['sd']:.{digits}f})" if deviation and spread["sd"] is not None else mean


def first(found: Mapping[str, Any]) -> str:
    """Return table 1 under both controls, with the paper's values."""
    rows = []
    for row in found["table1"]:
        cells = [text(row[name], name) for name in MEASURES]
        rows.append(
            [f"`{row['method']}`", CONTROLS[row["control"]], *cells, f"{row['overlap']['mean']:.2f}", str(row["n"])]
        )
    for row in found["table1"]:
        if row["control"] == "tracking" and "paper" in row:
            cells = [str(row["paper"][name]) for name in MEASURES]
            rows.append([f"the paper's {row['method']}", "head and hands", *cells, "", "24"])
    return table_of(["method", "driven by", *MEASURES.values(), "overlap", "people"], rows)


def along(found: Mapping[str, Any], key: str, rows_of: str, names: Sequence[str]) -> str:
    """Return means by side or part, under the true pose."""
    rows = [row for row in found[rows_of] if row["control"] == "pose"]
    labels = list(dict.fromkeys(row[key] for row in rows))
    by = {(row["method"], row[key]): row for row in rows}
    lines = [
        [f"`{method}`", *(" / ".join(text(by[method, label][name], name, False) for name in names) for label in labels)]
        for method in found["methods"]
    ]
    return table_of(["method", *labels], lines)


def pairs(found: Mapping[str, Any]) -> str:
    """Return comparisons of methods that are neighbours in the expected order, under the true pose."""
    wanted = [("photo", "mesh-image"), ("mesh-video", "photo"), ("scan", "mesh-video")]
    rows = []
    for first_, second in wanted:
        for name in MEASURES:
            for row in found["statistics"]:
                names = {row["first"], row["second"]}
                if row["control"] == "pose" and row["measure"] == name and names == {first_, second}:
                    sign = 1 if row["first"] == first_ else -1
                    digits = 2 if name == "psnr" else 4
                    low, high = sorted((sign * row["low"], sign * row["high"]))
                    cells = [f"{sign * row['mean']:+.{digits}f}", f"{low:+.{digits}f} to {high:+.{digits}f}"]
                    rows.append(
                        [
                            f"`{first_}` less `{second}`",
                            MEASURES[name],
                            *cells,
                            f"{sign * row['effect']:+.2f}",
                            f"{row['p_holm']:.1g}",
                        ]
                    )
    return table_of(["methods", "measure", "difference", "95 % interval", "effect", "p (Holm)"], rows)


def costs(found: Mapping[str, Any]) -> str:
    """Return table 2."""
    rows = []
    for row in found["timing"]["costs"]:
        paper = row.get("paper", {})
        count = f"{row['count']:,} {row['kind']}"
        cells = [f"{row['pair_ms']:.0f}", f"{row['two_ms']:.0f}", f"{row['two_ms'] / row['pair_ms']:.2f}"]
        memory = f"{row['bytes'] / 1e6:.1f}"
        papers = f"{paper['pair_ms']} ({paper['gain']}x)" if paper else ""
        rows.append(
            [f"`{row['method']}`", f"2 x {row['size']}^2", count, *cells, memory, f"{row['lpips']:.3f}", papers]
        )
    heads = ["method", "pixels", "of", "both at once (ms)", "two renders (ms)", "gain", "GPU memory (MB)", "LPIPS"]
    return table_of([*heads, "the paper's (GPU)"], rows)


def made(found: Mapping[str, Any]) -> str:
    """Return median seconds and megabytes per avatar."""
    rows = []
    for method in found["methods"]:
        mine = [row["product"] for row in found["participants"] if row["method"] == method and "product" in row]
        seconds, size = (sorted(one[key] for one in mine)[len(mine) // 2] for key in ("seconds", "bytes"))
        rows.append([f"`{method}`", f"{seconds:.0f}", f"{size / 1e6:.1f}"])
    return table_of(["method", "made in (s)", "file (MB)"], rows)


def poses(found: Mapping[str, Any]) -> str:
    """Return the share of the error that the true pose removes."""
    by = {(row["method"], row["control"]): row for row in found["table1"]}
    rows = []
    for method in found["methods"]:
        cells = []
        for name in ("l1", "lpips"):
            tracked, posed = (by[method, control][name]["mean"] for control in CONTROLS)
            cells.append(f"{1 - posed / tracked:.0%}")
        gain = by[method, "pose"]["psnr"]["mean"] - by[method, "tracking"]["psnr"]["mean"]
        rows.append([f"`{method}`", *cells, f"{gain:+.1f} dB"])
    return table_of(["method", "of L1", "of LPIPS", "PSNR"], rows)


def tables(found: Mapping[str, Any]) -> Iterator[Table]:
    """Yield the page's tables."""
    yield "methods", "Mean over people and, in brackets, their standard deviation, and the paper's.", first(found)
    yield "pose", "What the true pose takes off the error of head-and-hands tracking.", poses(found)
    about = "PSNR and LPIPS of the whole square under the true pose."
    yield "sides", about, along(found, "view", "views", ("psnr", "lpips"))
    about = "PSNR and SSIM of the part's own pixels under the true pose."
    yield "parts", about, along(found, "part", "parts", ("psnr", "ssim"))
    about = "Under the true pose; `glsplat.extras.evaluate.statistics`, Holm's correction."
    yield "pairs", about, pairs(found)
    yield "made", "Making one avatar: medians of one core beside another job.", made(found)
    if found["timing"]:
        about = (
            "Drawing one avatar: medians of 30 frames that took turns, read back; memory of a renderer of both eyes."
        )
        yield "costs", about, costs(found)


def page(found: Mapping[str, Any]) -> bytes:
    """Return docs/measured/evaluation.md."""
    said = f"Commit {found['made_by']}, {found['date']}. {found['drivers']}; {found['machine']}.\n"
    said += f"Failed: {found['failures'] or 'none'}."
    how = "python -m tools.docs.evaluation_results out/evaluation"
    return page_of("Avatars compared with people", how, said, tables(found))


def main() -> None:
    """Write the page."""
    found = json.loads((Path(sys.argv[1]) / "evaluation.json").read_text())
    replace_file(FOLDER / "evaluation.md", [page(found)])


if __name__ == "__main__":
    main()
