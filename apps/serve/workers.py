"""The options of ``glsplat serve`` for workers: other processes, or Ray's actors, that draw (docs/scaling.md)."""

from __future__ import annotations

import argparse

from glsplat.extras.workers.cluster import require_ray
from glsplat.extras.workers.options import Workers

from ..usage import UsageError

__all__ = ["add_workers", "workers_of"]

_MOST = 64


def add_workers(parser: argparse.ArgumentParser) -> None:
    """--workers, --worker-cpus, --worker-gpus, --ray-address."""
    parser.add_argument(
        "--workers",
        metavar="N|ray[:N]",
        help="have N processes of this machine draw and encode, or N actors of a Ray cluster (ray alone: as many as it "
        "has room for); docs/scaling.md",
    )
    parser.add_argument("--worker-cpus", type=float, default=1.0, metavar="N", help="CPUs of an actor (default 1)")
    parser.add_argument("--worker-gpus", type=float, default=0.0, metavar="N", help="GPUs of an actor, as 0.25 (0)")
    parser.add_argument(
        "--ray-address", metavar="ADDRESS", help="the cluster (default: RAY_ADDRESS, one on this machine, or a new one)"
    )


def workers_of(args: argparse.Namespace) -> Workers | None:
    """None where the server itself draws. Raises UsageError, and GlsplatError where Ray is not installed."""
    if args.workers is None:
        if args.ray_address is not None:
            raise UsageError("--ray-address is for --workers ray")
        return None
    kind, _, number = args.workers.partition(":")
    ray = kind == "ray"
    text = number if ray else args.workers
    if (
        (text or not ray) and not (text.isascii() and text.isdigit() and 1 <= int(text) <= _MOST)
    ) or args.workers == "ray:":
        raise UsageError(f"--workers needs 1 to {_MOST}, ray, or ray:N, not {args.workers!r:.40}")
    if not 0 <= args.worker_cpus <= 1024 or not 0 <= args.worker_gpus <= 1024:
        raise UsageError("--worker-cpus and --worker-gpus need 0 to 1024")
    if not ray and args.ray_address is not None:
        raise UsageError("--ray-address is for --workers ray")
    if ray:
        require_ray()
    return Workers(
        count=int(text) if text else None,
        ray=ray,
        cpus=args.worker_cpus,
        gpus=args.worker_gpus,
        address=args.ray_address,
    )
