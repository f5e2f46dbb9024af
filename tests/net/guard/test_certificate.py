"""The certificate that a server signs itself: what is in it, when it is made anew, and that TLS takes it."""

from __future__ import annotations

import ssl
import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import aiohttp
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.extras.operations import certificate
from glsplat.extras.operations.certificate import CERTIFICATE, KEY, kept_certificate
from glsplat.net.client import Client
from glsplat.net.guard.access import Access, certificate_names, server_tls
from glsplat.net.guard.state_dir import state_folder
from glsplat.net.server import ServerConfig

pytestmark = pytest.mark.check

ROOT = Path(__file__).parents[3]
TOKEN = "correct-horse-battery"


@pytest.fixture
def folder(state):
    return state_folder()


def names_in(path):
    found = x509.load_pem_x509_certificate(path.read_bytes()).extensions
    names = found.get_extension_for_class(x509.SubjectAlternativeName).value
    return names.get_values_for_type(x509.DNSName), list(map(str, names.get_values_for_type(x509.IPAddress)))


def test_what_is_in_it(folder):
    kept = kept_certificate(folder, ("Lab.Example.", "*.lab.example", "192.0.2.7", "[2001:DB8::1]", "lab.example"))
    assert kept.path == folder / KEY and kept.remade == ""
    assert certificate_names(kept.path, server_tls(kept.path, kept.path)) == (
        "localhost",
        "lab.example",
        "*.lab.example",
    )
    assert names_in(kept.path) == (
        ["localhost", "lab.example", "*.lab.example"],
        ["127.0.0.1", "::1", "192.0.2.7", "2001:db8::1"],
    )
    made = x509.load_pem_x509_certificate(kept.path.read_bytes())
    assert isinstance(made.public_key().curve, ec.SECP256R1)
    assert kept.fingerprint.replace(":", "").lower() == made.fingerprint(hashes.SHA256()).hex()
    now = datetime.now(UTC)
    assert made.not_valid_before_utc < now - timedelta(hours=12)
    assert timedelta(days=729) < made.not_valid_after_utc - now <= timedelta(days=730)
    assert not made.extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_the_key_is_for_its_user_alone_and_not_in_the_public_part(folder):
    kept = kept_certificate(folder, ())
    assert stat.S_IMODE(kept.path.stat().st_mode) == 0o600 and b"PRIVATE KEY" in kept.path.read_bytes()
    public = (folder / CERTIFICATE).read_bytes()
    assert b"PRIVATE" not in public and kept.path.read_bytes().endswith(public)


def test_it_is_kept(folder):
    first = kept_certificate(folder, ("lab.example", "192.0.2.7"))
    stamp = first.path.stat().st_mtime_ns
    again = kept_certificate(folder, ("192.0.2.7",))  # fewer names: it will do
    assert again == first and again.path.stat().st_mtime_ns == stamp
    (folder / CERTIFICATE).unlink()
    assert kept_certificate(folder, ()) == first
    assert (folder / CERTIFICATE).read_bytes() in first.path.read_bytes()


def test_a_missing_name_makes_a_new_one_that_keeps_addresses_only(folder):
    """Names that were allowed once would be let in for ever; an address is always right."""
    first = kept_certificate(folder, ("old.example", "192.0.2.7"))
    second = kept_certificate(folder, ("new.example", "198.51.100.9"))
    assert second.fingerprint != first.fingerprint
    assert second.remade == "the one that was kept lacks new.example, 198.51.100.9"
    assert names_in(second.path) == (["localhost", "new.example"], ["127.0.0.1", "::1", "198.51.100.9", "192.0.2.7"])
    assert kept_certificate(folder, ("new.example", "192.0.2.7")) == (second.path, second.fingerprint, "")


def test_addresses_do_not_pile_up(folder):
    for number in range(1, 41):
        kept = kept_certificate(folder, (f"192.0.2.{number}",))
    addresses = names_in(kept.path)[1]
    assert len(addresses) == 2 + 1 + 32 and "192.0.2.39" in addresses and "192.0.2.1" not in addresses


@pytest.mark.parametrize(
    ("setting", "days", "reason"),
    [("_LIFETIME", 29, "the one that was kept ends on 20"), ("_BACKDATED", -2, "the one that was kept begins on 20")],
)
def test_one_that_ends_soon_or_begins_later_is_made_anew(folder, monkeypatch, setting, days, reason):
    with monkeypatch.context() as patch:
        patch.setattr(certificate, setting, timedelta(days=days))
        first = kept_certificate(folder, ())
    second = kept_certificate(folder, ())
    assert second.fingerprint != first.fingerprint and second.remade.startswith(reason)


DAMAGED = {
    "empty": lambda data: b"",
    "cut off": lambda data: data[:-200],
    "no PEM": lambda data: b"\x00\xff" * 300,
    "no base64": lambda data: data[:400].replace(b"A", b"!") + data[400:],
    "another signature": lambda data: data[:-60] + bytes(data[-60:-50]).swapcase() + data[-50:],
    "too large": lambda data: data + b"\n" * 70_000,
    "no key": lambda data: data[data.index(b"-----BEGIN CERTIFICATE") :],
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_one_is_made_anew(folder, kind):
    path = kept_certificate(folder, ()).path
    path.write_bytes(DAMAGED[kind](path.read_bytes()))
    assert kept_certificate(folder, ()).remade == "the one that was kept is damaged"
    server_tls(path, path)
    assert kept_certificate(folder, ()).remade == ""


def test_another_certificates_key_is_a_damaged_one(folder, tmp_path):
    path = kept_certificate(folder, ()).path
    other = kept_certificate(tmp_path, ()).path.read_bytes()
    start = other.index(b"-----BEGIN CERTIFICATE")
    path.write_bytes(other[:start] + (folder / CERTIFICATE).read_bytes())
    assert kept_certificate(folder, ()).remade == "the one that was kept is damaged"


@pytest.mark.parametrize(
    "name", ["", "two words", "bücher.example", "a" * 64 + ".example", "*", "a.*.example", "lab:80"]
)
def test_names_that_no_certificate_can_hold(folder, name):
    with pytest.raises(GlsplatError, match="is not a name that a certificate can hold: expected letters, digits"):
        kept_certificate(folder, (name,))
    assert not list(folder.iterdir())


def test_a_full_disk_leaves_what_was_there(folder):
    """A limit on the size of files stands for it: both end a write half way."""
    kept_certificate(folder, ())
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    script = (
        "import resource\nfrom glsplat.extras.operations.certificate import kept_certificate\n"
        "from glsplat.net.guard.state_dir import state_folder\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500))\nkept_certificate(state_folder(), ['new.example'])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert "key-and-certificate.pem: cannot be written (File too large)" in done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_servers_that_start_at_once_share_one(state):
    script = (
        "import sys\nfrom glsplat.extras.operations.certificate import kept_certificate\n"
        "from glsplat.net.guard.state_dir import kept_token, state_folder\n"
        "print('ready', flush=True)\nsys.stdin.readline()\n"
        "folder = state_folder()\nprint(kept_certificate(folder, []).fingerprint, kept_token(folder))\n"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    servers = [subprocess.Popen([sys.executable, "-c", script], cwd=ROOT, **pipes) for _ in range(3)]
    for server in servers:
        assert server.stdout.readline() == "ready\n"
    for server in servers:
        server.stdin.write("\n")
        server.stdin.flush()
    said = [server.communicate(timeout=60)[0] for server in servers]
    assert len(set(said)) == 1 and len(said[0]) > 100


def test_a_key_with_a_passphrase_is_refused(folder, tmp_path):
    key = serialization.load_pem_private_key(kept_certificate(folder, ()).path.read_bytes(), None)
    locked = serialization.BestAvailableEncryption(b"secret")
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, locked)
    (tmp_path / "locked.pem").write_bytes(pem)
    with pytest.raises(GlsplatError, match="without a passphrase"):
        server_tls(folder / CERTIFICATE, tmp_path / "locked.pem")


async def test_tls_takes_it_and_clients_trust_it(serve, cameras, folder):
    """Page, status and wss on one port; names that are in it are let in, others are not."""
    kept = kept_certificate(folder, ("lab.example",))
    config = ServerConfig(port=0, tls=(kept.path, kept.path), access=Access(tls=True, token=TOKEN))
    trusting = ssl.create_default_context(cafile=folder / CERTIFICATE)
    async with serve(config=config) as server, aiohttp.ClientSession() as http:
        with pytest.raises(ProtocolError, match="not trusted; give it with --tls-ca"):
            await Client(server.url, TOKEN).connect()
        with pytest.raises(ProtocolError, match="uses TLS: use an address that begins with wss://"):
            await Client(server.url.replace("wss:", "ws:"), TOKEN).connect()
        async with Client(server.url, TOKEN, cafile=folder / CERTIFICATE) as client:
            assert (await client.render(cameras)).frame_id == 1
        codes = {}
        for host in ("localhost", "lab.example", "127.0.0.1", "other.example", "old.lab.example"):
            headers = {"Host": f"{host}:{server.port}", "Authorization": f"Bearer {TOKEN}"}
            async with http.get(f"https://127.0.0.1:{server.port}/stats", headers=headers, ssl=trusting) as response:
                codes[host] = response.status
        assert list(codes.values()) == [200, 200, 200, 421, 421], codes
        origin = {"Host": f"lab.example:{server.port}", "Origin": f"https://lab.example:{server.port}"}
        protocols = ("glsplat.v1", f"token.{TOKEN}")
        with pytest.raises(aiohttp.WSServerHandshakeError):  # on loopback no name is our own
            await http.ws_connect(server.url, headers=origin, protocols=protocols, ssl=trusting)
        origin = f"https://localhost:{server.port}"
        async with http.ws_connect(server.url, origin=origin, protocols=protocols, ssl=trusting):
            pass
