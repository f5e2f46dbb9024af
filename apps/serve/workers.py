"""The options of ``glsplat serve`` for workers: other processes, or Ray's actors, that draw (docs/scaling.md)."""

from __future__ import annotations

from glsplat.extras.workers.cluster import require_ray
from glsplat.extras.workers.pool import Workers

from ..usage import UsageError
from .options import ServeOptions

_MAX_WORKERS = 64


def workers_of(args: ServeOptions) -> Workers | None:
    """Return the workers of --workers; None where the server itself draws.

    Raises UsageError, and GlsplatError where Ray is not installed.
    """
    if args.workers is None:
        return None
    kind, _, number = args.workers.partition(":")
    ray = kind == "ray"
    if args.ray_address is not None and not ray:
        raise UsageError("ray-address is for --workers ray")
    text = number if ray else args.workers
    if (
        (text or not ray) and not (text.isascii() and text.isdigit() and 1 <= int(text) <= _MAX_WORKERS)
    ) or args.workers == "ray:":
        raise UsageError(f"{args.label('workers')} needs 1 to {_MAX_WORKERS}, ray, or ray:N, not {args.workers!r:.40}")
    if ray:
        require_ray()
    return Workers(
        count=int(text) if text else None,
        ray=ray,
        cpus=args.worker_cpus,
        gpus=args.worker_gpus,
        address=args.ray_address,
    )
