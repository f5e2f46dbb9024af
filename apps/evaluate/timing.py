"""Run-time cost of one participant's avatars: table 2 and the latency table of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.extras.evaluate.comparison.protocol import Protocol, perform, true_poses
from glsplat.extras.evaluate.comparison.stage import Stage
from glsplat.extras.evaluate.comparison.work import Result
from glsplat.extras.evaluate.costs import SIZES, costs
from glsplat.extras.evaluate.frames import WARM_UP
from glsplat.extras.evaluate.lpips import Lpips
from glsplat.formats.registry import load
from glsplat.gl.context import create_context
from glsplat.scene import Rigged, is_rigged

from ..progress import Progress
from ..replay import latency

_FRAMES = 30, 4  # measured frames, in a full and a quick run


def timed(
    results: Sequence[Result], people: Sequence[Participant], protocol: Protocol, folder: Path, quick: bool
) -> dict[str, Any]:
    """Return costs and latencies of the first participant with avatars of most methods; {} without any."""
    files: dict[str, dict[str, Path]] = {one.name: {} for one in people}  # of avatars, by participant and method
    for result in results:
        file = folder / "avatars" / result.method / f"{result.participant}.glb"
        if not result.failed and file.is_file():
            files[result.participant][result.method] = file
    chosen = max(people, key=lambda one: len(files[one.name]))
    if not files[chosen.name]:
        return {}
    figures: dict[str, Rigged] = {}
    for method, file in files[chosen.name].items():
        loaded = load(file)
        if is_rigged(loaded):
            figures[method] = loaded
    sizes = SIZES[:1] if quick else SIZES
    frames = _FRAMES[quick]
    with Progress(len(figures) * len(sizes) * (WARM_UP + frames), "timing") as bar:
        context = create_context()
        try:
            rows = costs(context, figures, sizes, frames, tick=bar.update)
        finally:
            context.release()
    for size in sizes:
        likeness = _likeness(chosen, figures, replace(protocol, size=size, views=("front",)))
        for row in rows:
            if row["size"] == size:
                row["lpips"] = likeness[row["method"]]
    streamed = []
    for method in figures:
        found = latency.measure(quick, avatar=files[chosen.name][method])
        streamed.append({"method": method, **found, "rows": latency.rows(found)})
    return {"participant": chosen.name, "costs": rows, "latency": streamed}


def _likeness(one: Participant, figures: Mapping[str, Rigged], protocol: Protocol) -> dict[str, float]:
    """Return the mean LPIPS over the tasks by method, from the front, in the true pose, at the protocol's size."""
    performance = perform(one.mesh, protocol.tasks)
    network = Lpips("alex")
    found: dict[str, list[float]] = {method: [] for method in figures}
    with Stage(one.mesh, performance, protocol, one.light) as stage:
        renderers = {method: stage.add(figure) for method, figure in figures.items()}
        poses = {
            method: true_poses(performance, one.mesh.skeleton, figure.skeleton) for method, figure in figures.items()
        }
        for moment in range(len(performance.moments)):
            truth = stage.truth(moment, "front")
            wanted = network.features(truth.pictures[0, ..., :3] / np.float32(255))
            for method, renderer in renderers.items():
                drawn = renderer.render(truth.cameras, poses[method][moment])
                seen = network.features(drawn[0, ..., :3] / np.float32(255))
                found[method].append(network.distance(seen, wanted))
    return {method: round(float(np.mean(values)), 4) for method, values in found.items()}
