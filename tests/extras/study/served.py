"""A study's server with stored pictures, in a process that may be killed: python -m tests.extras.study.served."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

from glsplat.extras.study.design import read_study
from glsplat.extras.study.plan import checked_plan
from glsplat.extras.study.serving.lead import StudyLead
from glsplat.extras.study.serving.live import Live
from glsplat.net.backend import AvatarInfo
from glsplat.net.served_scene import server_of
from glsplat.net.server import ServerConfig
from tests.browser.markers import as_tracked
from tests.browser.stored import Picture, StoredPairs


def main(study_path: str, data: str, participant: str, port: str) -> None:
    """Serve until a signal; prints the port and the secrets as a line of JSON."""
    study = read_study(study_path)
    plan = checked_plan(Path(data), study)
    live = Live(study, plan, int(participant), Path(data))
    lead = StudyLead(live, {one.name: "default" for one in study.conditions})
    offered = (AvatarInfo(name="default", solver=as_tracked, height=1.75, parts=frozenset({"head"})),)
    backend = StoredPairs(paint=lambda images, job: _mark(images) if "head" in job.options.hide else None)
    server = server_of(backend, ServerConfig(port=int(port)), offered, [lead])

    def started() -> None:
        print(json.dumps({"port": server.port, **lead.secrets}), flush=True)

    asyncio.run(server.run(started))


def _mark(images: Picture) -> None:
    """A picture without the head is red and nothing else."""
    images[:] = (255, 0, 0, 255)


if __name__ == "__main__":
    main(*sys.argv[1:])
