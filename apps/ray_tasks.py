"""Run independent tasks on a Ray cluster: the option ``--ray`` (docs/scaling.md)."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

from glsplat.errors import GlsplatError

# one core per task, as on a single machine: the last bits of sums depend on the number of threads
_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}


def add_ray(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --ray, which distributes ``what`` (a plural)."""
    parser.add_argument(
        "--ray",
        nargs="?",
        const="",
        metavar="ADDRESS",
        help=f"distribute {what} over a Ray cluster with a shared file system (default: RAY_ADDRESS, one on "
        "this machine, or a new one; docs/scaling.md)",
    )


def on_ray(work: Callable[[Any], Any], pieces: Sequence[Any], address: str) -> Iterator[tuple[int, Any]]:
    """Yield the index of each piece and the result of ``work``, as they finish; an exception if its process died.

    Each piece has its own process, whose state ``work`` may change. Raises the exceptions of ``work``, and GlsplatError
    without Ray. Unfinished pieces are cancelled when the caller stops.
    """
    from glsplat.extras.workers.cluster import require_ray  # here: slow to import

    require_ray()
    import ray

    try:
        ray.init(address or None, log_to_driver=False, configure_logging=False, namespace="glsplat")
    except Exception as error:
        text = str(error).strip().splitlines()
        raise GlsplatError(f"Ray cannot be reached: {text[-1] if text else type(error).__name__}") from None
    try:
        task = ray.remote(num_cpus=1, max_calls=1, max_retries=0)(_on_one_core)
        running = {task.remote(work, piece): place for place, piece in enumerate(pieces)}
        while running:
            done, _ = ray.wait(list(running))
            place = running.pop(done[0])
            try:
                yield place, ray.get(done[0])
            except ray.exceptions.RayTaskError as error:
                raise error.cause if isinstance(error.cause, Exception) else error from None
            except ray.exceptions.RayError:
                yield place, GlsplatError("its process or its machine has ended; memory may have run out")
    finally:
        with suppress(Exception):
            ray.shutdown()


def _on_one_core(work: Callable[[Any], Any], piece: Any) -> Any:
    os.environ.update(_ONE_CORE)
    import cv2

    cv2.setNumThreads(1)
    return work(piece)
