"""The option study: a server that leads one participant through a study."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TextIO

from glsplat.extras.study.design import read_study
from glsplat.extras.study.plan import checked_plan, label
from glsplat.extras.study.serving.lead import KEYS, StudyLead
from glsplat.extras.study.serving.live import Live

from ..study.files import DEFAULT, avatar_files, data_of
from ..usage import UsageError
from .options import ServeOptions
from .ready import Endpoint


@dataclass(frozen=True, slots=True)
class ServedStudy:
    """A study that is served, and the addresses of its two pages."""

    lead: StudyLead
    options: ServeOptions  # of the server, with the study's avatars

    def pages(self, endpoint: Endpoint, *, secret: bool) -> dict[str, str]:
        """Return the addresses for participant and experimenter; ``secret`` adds their secrets behind ``#``."""
        token = f"&token={endpoint.keys.token}" if endpoint.keys.token else ""
        paths = {"participant": "/vr/study.html", "experimenter": "/vr/watch.html"}
        return {
            who: endpoint.url(endpoint.names[0], path) + (f"#study={self.lead.secrets[who]}{token}" if secret else "")
            for who, path in paths.items()
        }

    def fields(self, endpoint: Endpoint) -> dict[str, str]:
        """Return the addresses for programs, and the file with the secrets, which go behind ``#study=``."""
        return self.pages(endpoint, secret=False) | {"keys": str(self.lead.live.store.folder / KEYS)}

    def announce(self, endpoint: Endpoint, out: TextIO) -> None:
        """Print the addresses, on a terminal with the secrets."""
        for who, address in self.pages(endpoint, secret=out.isatty()).items():
            print(f"  {who:<11} {address}", file=out)
        if not out.isatty():
            print(f"  {'links':<12}need #study=SECRET, in {self.lead.live.store.folder / KEYS}", file=out)
        out.flush()


def study_of(args: ServeOptions) -> ServedStudy:
    """Open the folder of the study's participant.

    Raises UsageError for options that do not fit, GlsplatError where the study is not as it was planned.
    """
    assert args.study is not None
    if args.participant is None:
        raise UsageError("a study needs its participant's number (participant)")
    if args.scene is not None or args.avatar or args.room or args.allow_upload is not None:
        raise UsageError("a study defines what is served: leave out SCENE, --avatar, --room and --allow-upload")
    study = read_study(args.study)
    data = data_of(args.study, args.study_data)
    plan = checked_plan(data, study)
    if not 1 <= args.participant <= len(plan.orders):
        raise UsageError(f"participant needs 1 to {len(plan.orders)}, not {args.participant}")
    files = avatar_files(study, label(args.participant))
    paths = dict.fromkeys(files.values())
    stems = [path.stem for path in paths if path is not None]
    if len(set(stems)) < len(stems) or DEFAULT in stems:
        raise UsageError(f"study: two avatars have the same file name, or one is called {DEFAULT}: rename one")
    for path in paths:
        if path is not None and not path.is_file():
            raise UsageError(f"study: no such avatar: {path}")
    first, *others = sorted(paths, key=lambda path: path is not None)  # the embedded one can only be the scene
    avatars = tuple(path for path in others if path is not None)
    served = replace(args, scene=None if first is None else str(first), avatar=avatars)
    live = Live(study, plan, args.participant, data)
    lead = StudyLead(live, {name: DEFAULT if path is None else path.stem for name, path in files.items()})
    return ServedStudy(lead, served)
