"""Tables of a comparison: means over participants of each participant's mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from glsplat.arrays import F64
from glsplat.extras.evaluate.comparison.measure import BOXED, MEASURES, OVERLAP, PARTED
from glsplat.extras.evaluate.comparison.protocol import CONTROLS
from glsplat.extras.evaluate.comparison.stage import PARTS
from glsplat.extras.evaluate.comparison.work import Result
from glsplat.extras.evaluate.statistics import compare

Groups = dict[str, dict[str, dict[str, float]]]
"""Values by label (a side, pose or body part), method and participant."""

PAPER: Mapping[str, Mapping[str, float]] = {
    "mesh-video": {"l1": 0.042, "lpips": 0.099, "psnr": 16.33, "ssim": 0.927},
    "mesh-image": {"l1": 0.043, "lpips": 0.103, "psnr": 16.74, "ssim": 0.917},
    "photo": {"l1": 0.033, "lpips": 0.082, "psnr": 17.92, "ssim": 0.934},
}
"""Table 1 of the paper, by the method with the same role here; of photographs of 24 people, other crops and poses."""


def means(results: Sequence[Result], method: str, control: str, measure: str) -> dict[str, float]:
    """Return each participant's mean over all moments, views and eyes, without failed results."""
    return {one.participant: float(np.nanmean(_array(one, control, measure))) for one in _good(results, method)}


def summary(results: Sequence[Result], methods: Sequence[str], people: int) -> list[dict[str, Any]]:
    """Return table 1: a row per method and control with mean and deviation of each measure over ``n`` of ``people``."""
    rows = []
    for control in CONTROLS:
        for method in methods:
            good = _good(results, method)
            row: dict[str, Any] = {"method": method, "control": control, "n": len(good), "of": people}
            for name in _measures(results):
                row[name] = _spread(list(means(results, method, control, name).values()))
            if method in PAPER:
                row["paper"] = dict(PAPER[method])
            rows.append(row)
    return rows


def compared(results: Sequence[Result], methods: Sequence[str], seed: int) -> list[dict[str, Any]]:
    """Return a row (statistics.Paired) per control, measure and pair of methods; a measure's pairs are one family."""
    rows = []
    for control in CONTROLS:
        for measure in _measures(results):
            values = {method: means(results, method, control, measure) for method in methods}
            for pair in compare(values, seed):
                found = {
                    key: _round(value) if isinstance(value, float) else value for key, value in asdict(pair).items()
                }
                rows.append({"control": control, "measure": measure, **found, "missing": list(pair.missing)})
    return rows


def by_participant(results: Sequence[Result], methods: Sequence[str]) -> list[dict[str, Any]]:
    """Return a row per participant and method: the paper's measures under both controls, or the failure."""
    rows = []
    order = {method: place for place, method in enumerate(methods)}
    for one in sorted(results, key=lambda one: (one.participant, order[one.method])):
        row: dict[str, Any] = {"participant": one.participant, "method": one.method}
        if one.failed:
            row["failed"] = one.failed
        else:
            row |= {"product": one.data["product"]}
            row |= {
                control: {name: _round(np.nanmean(_array(one, control, name))) for name in (*MEASURES, OVERLAP)}
                for control in CONTROLS
            }
        rows.append(row)
    return rows


def along(results: Sequence[Result], methods: Sequence[str], key: str) -> list[dict[str, Any]]:
    """Return a row per method, control, and visible side ("view"), pose ("moment") or body part ("part") of the person.

    Means of a body part are over the pictures that show it.
    """
    rows = []
    for control in CONTROLS:
        measures = PARTED if key == "part" else _measures(results)
        by_measure = {measure: grouped(results, methods, control, measure, key) for measure in measures}
        for method in methods:
            for label, values in next(iter(by_measure.values()), {}).items():
                if method in values:
                    row: dict[str, Any] = {"method": method, "control": control, key: label}
                    for measure, groups in by_measure.items():
                        row[measure] = _spread(list(groups[label][method].values()))
                    rows.append(row)
    return rows


def grouped(results: Sequence[Result], methods: Sequence[str], control: str, measure: str, key: str) -> Groups:
    """Return one measure by side ("view"), pose ("moment") or body part ("part"), then method and participant."""
    groups: Groups = {}
    for method in methods:
        for one in _good(results, method):
            for label, array in _pieces(one, control, measure, key):
                if np.isfinite(array).any():
                    groups.setdefault(label, {}).setdefault(method, {})[one.participant] = float(np.nanmean(array))
    return groups


def failures(results: Sequence[Result]) -> list[dict[str, str]]:
    """Return participant, method and reason of each failure."""
    return [{"participant": r.participant, "method": r.method, "why": r.failed} for r in results if r.failed]


def _pieces(one: Result, control: str, measure: str, key: str) -> list[tuple[str, F64]]:
    """Return the values of a result by label: a moment, view or part."""
    if key == "part":
        return [(part, _numbers(one.data["parts"][control][part][measure])) for part in PARTS]
    array = _array(one, control, measure)
    axis = ("moment", "view").index(key)
    return [(label, np.asarray(array.take(place, axis=axis))) for place, label in enumerate(one.data[f"{key}s"])]


def _measures(results: Sequence[Result]) -> list[str]:
    """Return the measures in the results, the paper's first."""
    taken: Mapping[str, Any] = next((one.data["values"][CONTROLS[0]] for one in results if not one.failed), {})
    first = [*MEASURES, *BOXED, OVERLAP]
    return [name for name in (*first, *(name for name in taken if name not in first)) if name in taken]


def _good(results: Sequence[Result], method: str) -> list[Result]:
    return [one for one in results if one.method == method and not one.failed]


def _array(one: Result, control: str, measure: str) -> F64:
    return _numbers(one.data["values"][control][measure])


def _numbers(values: Any) -> F64:
    """Return nested lists as an array [M, V, 2]; null becomes NaN."""
    return np.array(values, np.float64)


def _spread(values: Sequence[float]) -> dict[str, Any] | None:
    """Return mean, sample standard deviation (None for one value) and number of participants; None without any."""
    if not values:
        return None
    deviation = _round(np.std(values, ddof=1)) if len(values) > 1 else None
    return {"mean": _round(np.mean(values)), "sd": deviation, "n": len(values)}


def _round(value: Any) -> float:
    return round(float(value), 6)
