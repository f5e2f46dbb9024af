"""Files that hold secrets: what is said where others can read, change or replace one."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import pytest

from glsplat.extras.consent.keys import new_key, private_key
from glsplat.extras.operations.certificate import kept_certificate
from glsplat.extras.study.serving.lead import KEYS, secrets_of
from glsplat.extras.watermark.keys import new_watermark, read_watermark, text_of
from glsplat.io.secret_files import exposure
from glsplat.net.guard.access import read_token, server_tls

pytestmark = pytest.mark.skipif(os.name != "posix", reason="modes are POSIX's")

NOBODY = 65534


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "a token"
    path.write_text("0123456789abcdef")
    return path


@pytest.mark.parametrize(
    ("mode", "said"),
    [(0o600, ""), (0o400, ""), (0o700, ""), (0o640, "read"), (0o604, "read"), (0o644, "read"), (0o620, "change"),
     (0o602, "change"), (0o666, "read and change"), (0o777, "read and change"), (0o611, "")],
)  # fmt: skip
def test_a_mode_is_one_line_that_says_what_to_do(secret: Path, mode: int, said: str) -> None:
    secret.chmod(mode)
    line = exposure(secret)
    if not said:
        assert line == ""
        return
    assert line.startswith(f"{secret}: others can {said} it: expected mode 0600, got {mode:04o}; ")
    assert line.endswith(f"chmod 600 '{secret}'") and line.isprintable()


def test_a_link_is_what_it_leads_to(secret: Path) -> None:
    link = secret.with_name("link")
    link.symlink_to(secret)
    secret.chmod(0o600)
    assert exposure(link) == ""
    secret.chmod(0o646)
    assert "got 0646" in exposure(link)


def test_a_folder_in_which_others_replace_it(secret: Path) -> None:
    secret.chmod(0o600)
    for mode, said in ((0o755, False), (0o775, False), (0o777, True), (0o1777, False)):
        secret.parent.chmod(mode)
        assert ("can replace it" in exposure(secret)) == said, oct(mode)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")
def test_a_file_that_is_lent_may_be_its_groups_to_read(secret: Path) -> None:
    os.chown(secret, NOBODY, NOBODY)
    for mode, said in ((0o440, ""), (0o640, ""), (0o644, "read"), (0o660, "change")):
        secret.chmod(mode)
        assert (f"can {said} it" in exposure(secret)) if said else exposure(secret) == ""
    assert "chown" in exposure(secret)


def test_what_is_not_there_is_nobodys_to_read(tmp_path: Path) -> None:
    assert exposure(tmp_path / "away") == ""


def test_every_reader_of_a_secret_says_so_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    token, watermark, key = (tmp_path / name for name in ("token", "watermark", "key"))
    token.write_text("0123456789abcdef")
    watermark.write_text(text_of(new_watermark()))
    new_key(key)
    tls = kept_certificate(tmp_path, ("localhost",)).path
    secrets_of(tmp_path)
    readers = {
        token: lambda: read_token(token),
        watermark: lambda: read_watermark(watermark),
        key: lambda: private_key(key),
        tls: lambda: server_tls(tls, tls),
        tmp_path / KEYS: lambda: secrets_of(tmp_path),
    }
    for mode in (0o600, 0o666):
        for path, read in readers.items():
            path.chmod(mode)
            caplog.clear()
            read()
            lines = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
            assert len(lines) == (mode == 0o666), path
            assert all(str(path) in line and "got 0666" in line and "0123456789" not in line for line in lines)
