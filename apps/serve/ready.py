"""The lines in the terminal once clients can connect: the page's address, a QR code, the certificate."""

from __future__ import annotations

import logging
import shutil
import threading
import webbrowser
from dataclasses import dataclass, field
from typing import TextIO

from glsplat.net.guard.access import is_loopback
from glsplat.net.guard.host_info import machine_names, reachable_at
from glsplat.optional import has_package, missing, missing_package, plugin

from .keys import Keys

log: logging.Logger = logging.getLogger("glsplat.serve")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where a running server listens."""

    host: str
    port: int
    keys: Keys = field(default_factory=Keys)

    @property
    def local(self) -> bool:
        """Whether only this machine can reach the server."""
        return is_loopback(self.host)

    @property
    def names(self) -> tuple[str, ...]:
        """Addresses or names for browsers, the best first; never empty."""
        if self.host in ("127.0.0.1", "localhost"):
            return ("localhost",)
        return reachable_at(self.host) or machine_names()[-1:] or ("localhost",)

    @property
    def here(self) -> str:
        """The server's name for a browser on this machine."""
        return "localhost" if self.host in ("0.0.0.0", "::") else self.names[0]

    def url(self, name: str, path: str, scheme: str = "http") -> str:
        """Return an address under a name; ``scheme`` is http or ws, which becomes https or wss with TLS."""
        secure = "s" if self.keys.tls else ""
        return f"{scheme}{secure}://{f'[{name}]' if ':' in name else name}:{self.port}{path}"

    def page(self, name: str, *, token: bool = False) -> str:
        """Return the page's address under a name; a token stands behind ``#``, a part that browsers do not send."""
        return self.url(name, "/vr") + (f"#token={self.keys.token}" if token and self.keys.token else "")


def announce(endpoint: Endpoint, out: TextIO, show_qr: bool, status: bool = True) -> None:
    """Print the addresses. The token is printed to a terminal only, or with ``show_qr``.

    ``status`` is False where nobody may open the status page.
    """
    person = out.isatty()
    name, *others = endpoint.names
    address = endpoint.page(name, token=person or show_qr)
    rows = [("page", address)] + ([("status", endpoint.url(name, "/"))] if status else [])
    rows.append(("WebSocket", endpoint.url(name, "/ws", "ws")))
    if others:
        rows.append(("also at", ", ".join(others)))
    if endpoint.local:
        port = endpoint.port
        rows.append(("by cable", f"adb reverse tcp:{port} tcp:{port}, then the page in the headset's browser"))
    elif not endpoint.keys.tls:
        rows.append(("no VR", "browsers offer it on https or localhost alone; --self-signed makes a certificate"))
    if endpoint.keys.fingerprint:
        rows.append(("certificate", f"SHA-256 {endpoint.keys.fingerprint}"))
    if endpoint.keys.token_file and not endpoint.local:
        rows.append(("token", f"in {endpoint.keys.token_file}"))
    if endpoint.keys.accounts:
        rows.append(("token", "each account has its own (glsplat users); the page asks for it"))
    for label, text in rows:
        print(f"  {label:<12}{text}", file=out)
    if show_qr or (person and status and not endpoint.local):  # other devices cannot open a local address
        _print_qr(address, out, person)
    out.flush()


def _print_qr(address: str, out: TextIO, person: bool) -> None:
    if not has_package("segno"):
        print(f"  ({missing_package('a QR code', 'segno', 'server')})", file=out)
        return
    qr = plugin("operations.qr")  # here: most outputs are no terminal
    if qr is None:
        print(f"  ({missing('operations', 'a QR code')})", file=out)
        return
    lines, columns = qr.terminal(address)
    if person and shutil.get_terminal_size().columns < columns:
        print(f"  (no QR code: it needs a terminal of {columns} columns)", file=out)
        return
    text = "\n".join(lines)
    try:
        text.encode(out.encoding or "utf-8")
    except UnicodeEncodeError:
        print(f"  (no QR code: it needs UTF-8, this terminal has {out.encoding})", file=out)
        return
    print(text, file=out)


def open_page(endpoint: Endpoint) -> threading.Thread:
    """Open the page in this machine's browser, without waiting for it.

    The address has no token, as every user of the machine can read a program's arguments. The page asks for it.
    """
    address = endpoint.page(endpoint.here)

    def work() -> None:
        try:
            opened = webbrowser.open(address)
        except (webbrowser.Error, OSError):
            opened = False
        if not opened:
            log.warning("open: no browser could be started; open %s", address)

    thread = threading.Thread(target=work, name="open", daemon=True)
    thread.start()
    return thread
