"""The options of ``glsplat serve``: flags for those that most servers need, ``server.toml`` for all of them."""

from __future__ import annotations

import argparse
import difflib
import json
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any

from glsplat.camera import PAPER_FOV, PAPER_IPD
from glsplat.errors import GlsplatError
from glsplat.formats.scene_file import UPS
from glsplat.light.light import PRESETS
from glsplat.net.backends.gl import MAX_PICTURE_S
from glsplat.net.guard.forwarded import Network, proxy_network
from glsplat.net.options import DEFAULT_SEATS, MAX_WINDOW, NAME
from glsplat.optional import has_extra, missing
from glsplat.tracking.solvers import SOLVERS, SolverName

from ..args import Number, as_toml, detail_level, light_name, size, whole
from ..logs import FORMATS
from ..usage import CommandParser, UsageError

_MAX_SEATS = 64


@dataclass(frozen=True)
class RoomChoice:
    """A room as it is requested: NAME[:SEATS][=SCENE]."""

    name: str
    seats: int = DEFAULT_SEATS
    scene: str | None = None


def room_choice(text: str) -> RoomChoice:
    """Parse a room. Raises ArgumentTypeError."""
    head, _, scene = text.partition("=")
    found = re.fullmatch(r"(.*?)(?::([0-9]{1,4}))?", head)
    assert found is not None
    name, seats = found[1], int(found[2] or DEFAULT_SEATS)
    if not NAME.fullmatch(name):
        raise argparse.ArgumentTypeError(f"a room's name needs 1 to 32 letters, digits, blanks or _.'-, not {name!r}")
    if not 1 <= seats <= _MAX_SEATS:
        raise argparse.ArgumentTypeError(f"a room holds 1 to {_MAX_SEATS} people, not {seats}")
    return RoomChoice(name, seats, scene or None)


def _one_of(names: Sequence[str]) -> Callable[[str], str]:
    def parse(text: str) -> str:
        if text not in names:
            raise argparse.ArgumentTypeError(f"needs one of {', '.join(names)}, not {as_toml(text)}")
        return text

    return parse


def _option(
    default: Any,
    text: str,
    parse: Callable[[str], Any] = str,
    *,
    flag: str | None = None,
    sample: Any = None,
    number: bool = False,
    needs: str | None = None,
    extra: str | None = None,
    off: object = False,
) -> Any:
    """Return a field. ``flag``: its placeholder on the command line, None where only the file has it.

    A default of False makes a switch, one of () a list. ``sample``: a value for the file where the default is none.
    ``number``: the file may have a whole number instead of a text. ``needs``: an option that has to be given, too.
    ``extra``: the folder of glsplat/extras that any value but ``off`` needs.
    """
    return field(
        default=default,
        metadata={
            "text": text,
            "parse": parse,
            "flag": flag,
            "sample": sample,
            "number": number,
            "needs": needs,
            "extra": extra,
            "off": off,
        },
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOptions:
    """All options; each names its unit and what the default means. The names in the file have "-" for "_"."""

    filed: Mapping[str, str] = field(default_factory=dict, repr=False, compare=False)
    """Names of the options that a file has, as errors show them: "avatar": "server.toml: avatar"."""

    scene: str | None = _option(
        None, "a splat file, an avatar, a scene file (JSON) or an embedded person; default: the embedded avatar",
        flag="SCENE", sample="me.glb",
    )  # fmt: skip
    avatar: tuple[Path, ...] = _option(
        (), "another avatar that clients may choose, by the file's name without its suffix; may be repeated (the first "
        "is SCENE, the embedded one is called default)", Path, flag="FILE", sample="ann.glb",
    )  # fmt: skip
    room: tuple[RoomChoice, ...] = _option(
        (), "NAME[:SEATS][=SCENE]: a room in which clients meet, each as one of the avatars, seen by all others "
        f"(/ws?room=NAME&name=ANN); for SEATS people (default {DEFAULT_SEATS}), in front of SCENE (default nothing); "
        "may be repeated", room_choice, flag="ROOM", sample="lab:4",
    )  # fmt: skip
    voice: bool = _option(
        False, "let the people of a room talk, from browser to browser: their browsers see each other's IP addresses",
        flag="", needs="room", extra="voice",
    )  # fmt: skip
    host: str = _option("127.0.0.1", "address to listen on; 127.0.0.1 is this machine alone", flag="HOST")
    port: int = _option(8000, "port; 0: any free one", whole(0, 65535), flag="PORT")
    size: tuple[int, int] | None = _option(
        None, "WxH, pixels of an eye where requests name none, and what the page begins with (default: the largest of "
        "1024, 768 and 512 that is drawn 15 times a second here, found at the start)", size,
        flag="WxH", sample="1024x1024", number=True,
    )  # fmt: skip
    self_signed: bool = _option(
        False, "make and keep a certificate for https and wss, and beyond this machine a token "
        "($XDG_STATE_HOME/glsplat, ~/.local/state/glsplat); browsers ask once whether to trust it",
        flag="", extra="operations",
    )  # fmt: skip
    insecure: bool = _option(False, "listen beyond this machine without TLS and token", flag="")
    users: Path | None = _option(
        None,
        "clients need the token of an account in this file (glsplat users)",
        Path,
        flag="FILE",
        sample="users.json",
        extra="accounts",
    )
    allow_upload: Path | None = _option(
        None, "let clients (those with the token, where there is one) send photographs of a person and have avatars "
        "made of them, which are kept in this folder and offered to all clients; needs the networks of 'glsplat models "
        "get'", Path, flag="DIR", sample="avatars", extra="uploads",
    )  # fmt: skip
    workers: str | None = _option(
        None, "N or ray[:N]: have N processes of this machine draw and encode, or N actors of a Ray cluster (ray "
        "alone: as many as it has room for); docs/scaling.md",
        flag="N|ray[:N]", sample="2", number=True, extra="workers",
    )  # fmt: skip
    json: bool = _option(False, "print addresses and driver as a JSON line once ready", flag="")
    verbose: bool = _option(False, "log tracebacks of failed pictures", flag="")

    # ------------------------------------------------------------------------------------------------------- pictures
    up: str = _option("y", f"the scene file's axis that points up: {', '.join(UPS)}", _one_of(UPS))
    strict: bool = _option(False, "refuse files with NaN or infinity")
    light: str | None = _option(
        None, f"light avatars with surface data (docs/light.md): {', '.join(PRESETS)}, or a JSON file; none: "
        "as they were photographed (default: as a scene file says, else none)", light_name, sample="day",
    )  # fmt: skip
    max_size: int = _option(2048, "pixels of the largest side that a request may have", whole(1, 8192))
    quality: int = _option(80, "JPEG quality, 1 to 100, where requests name none", whole(1, 100))
    ipd: float = _option(PAPER_IPD, "metres between the eyes, for requests with heads", Number(0, 0.2, "m"))
    fov: float = _option(PAPER_FOV, "vertical degrees, for requests with heads", Number(1, 170, "degrees"))
    mirror: bool = _option(False, "show the mirror image (clients may choose by /ws?mirror=)")
    level: int | str | None = _option(
        None, "level of detail: 0 the finest, higher numbers coarser, auto: by the pixels covered (default auto)",
        detail_level, sample="auto", number=True,
    )  # fmt: skip
    lod_bias: float | None = _option(
        None, "of level auto, in halvings of the shown detail: 1 for finer levels, -1 for coarser ones (default 0)",
        Number(-8, 8), sample=0.5,
    )  # fmt: skip
    cull_hidden: bool = _option(
        False, "leave out splats that visibility cones call hidden (default: where the picture barely changes)"
    )
    exact: bool = _option(False, "draw every splat of the finest level, to its end")
    max_cost: float | None = _option(
        None, "pixels that a picture may cover, splat by splat and eye by eye; costlier ones are refused, and clients "
        "that repeat them are dropped (default 5e8, with exact 1e9)", Number(1, unit="pixels"), sample=5e8,
    )  # fmt: skip
    max_time: float = _option(
        MAX_PICTURE_S,
        "seconds that a picture may take; one that takes longer is abandoned, a second one ends its client",
        Number(0.1, 600, "s"),
    )  # fmt: skip
    device: str | None = _option(
        None, "EGL device: index or part of its name (also GLSPLAT_DEVICE); with workers several: a,b", sample="0",
        number=True,
    )  # fmt: skip
    # ---------------------------------------------------------------------------------------------------------- links
    fps: float | None = _option(
        None, "pictures a second to hold for each client: coarser levels of detail first, then smaller pictures, as "
        "replies say (default: 6 for members of a room, else as many as are requested)",
        Number(1, 240, "pictures a second"), sample=45,
    )  # fmt: skip
    bitrate: float | None = _option(
        None, "Mbit/s at most for each client that reports arrivals (default: as much as its link takes)",
        Number(0.1, 1e5, "Mbit/s"), sample=20,
    )  # fmt: skip
    fixed: bool = _option(
        False, "do not fit size and quality to the links of clients that report arrivals, nor to a room"
    )
    video: bool = _option(
        False, "send video instead of JPEGs to clients that decode it: far fewer bytes, more CPU; needs glsplat[video]"
    )
    webtransport: bool = _option(
        False, "send pictures over links of 8 ms and more by datagrams to clients that accept them, as the page in "
        "Chromium; listens to UDP at the same port number; needs glsplat[webtransport]",
    )  # fmt: skip
    window: int = _option(2, "pictures under way for a client", whole(1, MAX_WINDOW))
    # ---------------------------------------------------------------------------------------------------------- voice
    ice: tuple[str, ...] = _option(
        (), "STUN and TURN servers by which browsers find a path to each other: stun:HOST[:PORT], turn:HOST[:PORT], "
        "turns:HOST[:PORT] (default: none, which does for one network)", sample="turn:turn.example.org:3478",
        needs="voice",
    )  # fmt: skip
    turn_secret_file: Path | None = _option(
        None, "file with the secret shared with the TURN servers (coturn: use-auth-secret); browsers get passwords "
        "made from it, each for 12 hours", Path, sample="turn-secret", needs="voice",
    )  # fmt: skip
    relay_only: bool = _option(
        False, "send voices through the TURN servers only: browsers then do not see each other's IP addresses",
        needs="voice",
    )  # fmt: skip
    # -------------------------------------------------------------------------------------------------------- clients
    max_clients: int = _option(8, "clients at once", whole(1, 256))
    max_per_address: int | None = _option(
        None, "clients of one address (default: half of max-clients; on loopback without trusted-proxy all)",
        whole(1, 256), sample=4,
    )  # fmt: skip
    max_waiting: int = _option(64, "connections that are not yet clients", whole(2, 4096))
    private: bool = _option(False, "show nobody who the clients are and what they see")
    # ------------------------------------------------------------------------------------------------------- tracking
    calibration: Path | None = _option(
        None, "file of the users whose tracking is sent (default: their size is found)", Path, sample="me.json"
    )
    solver: SolverName = _option(SOLVERS[0], f"solves the body: {', '.join(SOLVERS)}", _one_of(SOLVERS))
    no_idle: bool = _option(
        False, "eyes of tracked users that no sensor sees neither look around nor blink", extra="speech", off=True
    )
    face_osc: int | None = _option(
        None, "UDP port on 127.0.0.1 that takes the wearer's face from VRCFaceTracking (it sends to 9000)",
        whole(0, 65535), sample=9000, extra="speech",
    )  # fmt: skip
    # ---------------------------------------------------------------------------------------------------------- study
    study: Path | None = _option(
        None, "lead a participant through this study (docs/study.md); its conditions say which avatars are served",
        Path, sample="study.toml", extra="study",
    )  # fmt: skip
    participant: int | None = _option(
        None, "number of the study's participant, from 1", whole(1, 10**6), sample=7, needs="study"
    )
    study_data: Path | None = _option(
        None, "folder of the study's plan and data (default: data beside the study)", Path, sample="data", needs="study"
    )
    # -------------------------------------------------------------------------------------------------------- consent
    trust: tuple[Path, ...] = _option(
        (), "public keys whose signatures of consent count (glsplat avatar consent --new-key); without one every "
        "signature that fits does, and a line names its key", Path, sample="authority.pub",
    )  # fmt: skip
    without_consent: bool = _option(
        False, 'show avatars without a valid consent, too; "no consent on file" then stands in all their pictures'
    )
    # --------------------------------------------------------------------------------------------------------- access
    tls_cert: Path | None = _option(None, "certificate (PEM); makes it wss:// and https://", Path, sample="cert.pem")
    tls_key: Path | None = _option(None, "key of the certificate (PEM)", Path, sample="key.pem")
    token_file: Path | None = _option(None, "file with a token that clients need", Path, sample="token")
    watermark: str | None = _option(
        None, "on, off or a FILE with the key: mark the pictures of each session invisibly, so that `glsplat watermark "
        "detect` finds the session of a clip (docs/watermark.md); without FILE the key is kept in "
        "$XDG_STATE_HOME/glsplat (default on)", sample="on", extra="watermark", off="off",
    )  # fmt: skip
    origin: tuple[str, ...] = _option((), "web pages that may connect", sample="https://example.org")
    allow_host: tuple[str, ...] = _option((), "names of the server; *.NAME too", sample="avatars.example.org")
    trusted_proxy: tuple[Network, ...] = _option(
        (), "address or network (CIDR) of reverse proxies; limits then count for the clients that their "
        "X-Forwarded-For or Forwarded headers name", proxy_network, sample="127.0.0.1",
    )  # fmt: skip
    # -------------------------------------------------------------------------------------------------------- workers
    worker_cpus: float = _option(1.0, "CPUs of an actor", Number(0, 1024), needs="workers")
    worker_gpus: float = _option(0.0, "GPUs of an actor, such as 0.25", Number(0, 1024), needs="workers")
    ray_address: str | None = _option(
        None, "address of the cluster (default: RAY_ADDRESS, one on this machine, or a new one)", sample="auto",
        needs="workers",
    )  # fmt: skip
    # -------------------------------------------------------------------------------------------------------- console
    open: bool = _option(False, "open the page in this machine's browser once ready")
    qr: bool = _option(False, "print the page's address as a QR code (a terminal gets one)")
    log_format: str = _option(
        FORMATS[0], "log lines as text, or as JSON objects with time, level, logger, message", _one_of(FORMATS)
    )

    def label(self, name: str) -> str:
        """Return an option as errors show it: --avatar, or "server.toml: avatar"."""
        return self.filed.get(name, f"--{name}")


_FIELDS: dict[str, Field[Any]] = {one.name.replace("_", "-"): one for one in fields(ServeOptions) if one.metadata}


@contextmanager
def naming_option(args: ServeOptions, name: str, kind: type[GlsplatError] = GlsplatError) -> Iterator[None]:
    """Put file and name of an option that a file has before errors of its value."""
    try:
        yield
    except kind as error:
        if name not in args.filed:
            raise
        raise UsageError(f"{args.label(name)}: {error}") from None


def check_given(args: ServeOptions) -> None:
    """Raise UsageError for options without the option that they need, GlsplatError for a missing extra."""
    for name, one in _FIELDS.items():
        value, needs, extra = getattr(args, one.name), one.metadata["needs"], one.metadata["extra"]
        if name not in args.filed and value == one.default:
            continue
        if needs is not None and not getattr(args, needs):
            raise UsageError(f"{args.label(name)} is for {needs}: give {needs}, too, or leave it out")
        if extra is not None and value != one.metadata["off"] and not has_extra(extra):
            shown = f"{args.label(name)} = {as_toml(value)}" if name in args.filed else args.label(name)
            raise GlsplatError(missing(extra, shown))


class _WriteFile(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(option_file(), end="")
        parser.exit()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the flags; what the words do not name is absent from the result."""
    for name, one in _FIELDS.items():
        flag = one.metadata["flag"]
        if flag is None:
            continue
        settings: dict[str, Any] = {"help": _help(one).replace("%", "%%"), "default": argparse.SUPPRESS}
        if one.default is False:
            settings["action"] = "store_true"
        else:
            settings |= {"type": one.metadata["parse"], "metavar": flag}
            if one.default == ():
                settings["action"] = "append"
        if name == "scene":
            parser.add_argument(name, nargs="?", **settings)
        else:
            parser.add_argument(f"--{name}", **settings)
    parser.add_argument(
        "--config",
        type=Path,
        metavar="TOML",
        default=argparse.SUPPRESS,
        help=f"read options from this file, which has {len(_FIELDS)}; flags win over it",
    )
    text = "print a server.toml with every option explained, and stop"
    parser.add_argument("--write-config", action=_WriteFile, nargs=0, default=argparse.SUPPRESS, help=text)


def parsed(parser: CommandParser, words: Sequence[str]) -> ServeOptions:
    """Return the options of the command line, and of its --config those that it does not name, lists included.

    Raises UsageError naming file and option.
    """
    if lines := _unknown_flags(words):
        raise UsageError("; ".join(lines))
    given = vars(parser.parse_args(words))
    path = given.pop("config", None)
    read = {} if path is None else read_options(path)
    filed = {name: f"{path}: {name}" for name, one in _FIELDS.items() if one.name in read.keys() - given.keys()}
    lists = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
    return ServeOptions(filed=filed, **read | given | lists)


def _unknown_flags(words: Sequence[str]) -> list[str]:
    """Return a line for each word that is no flag but near an option's name; argparse refuses the others."""
    flags = [
        "help",
        "config",
        "write-config",
        *(name for name, one in _FIELDS.items() if one.metadata["flag"] is not None),
    ]
    lines = []
    for word in words:
        name = word.partition("=")[0].removeprefix("--")
        if word == "--":
            break
        if not word.startswith("--") or any(flag.startswith(name) for flag in flags):
            continue
        for near in _nearest(name, [*_FIELDS, *flags]):
            hint = f"is it --{near}?" if near in flags else f"{near} goes into the file of --config"
            lines.append(f"--{name}: no such flag, {hint}")
    return lines


def _nearest(name: str, names: Sequence[str]) -> list[str]:
    return difflib.get_close_matches(name, names, 1, cutoff=0.65)


def read_options(path: Path) -> dict[str, Any]:
    """Return the options of a file, by the fields of ServeOptions. Raises UsageError."""
    try:
        found = tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not TOML ({' '.join(str(error).split())})") from None
    read = {}
    for name, value in found.items():
        if isinstance(value, dict):
            raise UsageError(f"{path}: tables are not used: leave out [{name}], each line is OPTION = VALUE")
        if name not in _FIELDS:
            hint = "".join(f"; is it {near}?" for near in _nearest(name, list(_FIELDS)))
            raise UsageError(f"{path}: expected an option of glsplat serve, got {name!r:.40}{hint}")
        try:
            read[_FIELDS[name].name] = _value(_FIELDS[name], value)
        except (argparse.ArgumentTypeError, GlsplatError) as error:
            raise UsageError(f"{path}: {name}: {error}") from None
    return read


def option_file() -> str:
    """Return a file for --config: each option with its explanation, commented out."""
    lines = ["# glsplat serve --config server.toml; flags win over it, paths are relative to the working folder", ""]
    for name, one in _FIELDS.items():
        lines += textwrap.wrap(
            _help(one), 96, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False, break_long_words=False
        )
        value = one.default if one.default is not None and one.default != () else one.metadata["sample"]
        lines += [f"#{name} = {json.dumps([value] if one.default == () else value)}", ""]
    return "\n".join(lines)


def _help(one: Field[Any]) -> str:
    text: str = one.metadata["text"]
    stated = one.default in (None, ()) or one.default is False or "(default" in text
    return text if stated else f"{text} (default {one.default})"


def _value(one: Field[Any], value: Any) -> Any:
    """Return a value of the file as the field has it. Raises ArgumentTypeError, GlsplatError."""
    parse, several = one.metadata["parse"], one.default == ()
    if one.default is False:
        if not isinstance(value, bool):
            raise argparse.ArgumentTypeError(f"needs true or false, not {as_toml(value)}")
        return value
    if isinstance(parse, Number):
        return parse.checked(value)
    kinds = (str, int) if one.metadata["number"] else (str,)
    values = value if several and isinstance(value, list) else [value]
    if any(type(part) not in kinds for part in values):
        more = " or a list of texts" if several else " or a whole number" if int in kinds else ""
        raise argparse.ArgumentTypeError(f"needs a text{more}, not {as_toml(value)}")
    found = tuple(parse(str(part)) for part in values)
    return found if several else found[0]
