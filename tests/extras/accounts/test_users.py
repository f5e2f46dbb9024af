"""Accounts in a file: made, read, changed while a server runs; broken files; who may do what."""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import os
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apps import cli
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.accounts import users
from glsplat.extras.accounts.users import Accounts, User, new_user, read_users, write_users
from glsplat.extras.consent.file import OnFile
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.net.guard.access import Access
from glsplat.net.rights import Rights

NAMES = st.text(max_size=80)


@pytest.fixture(autouse=True)
def _cheap_hashes(monkeypatch):
    monkeypatch.setattr(users, "_N", 2)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "users.json"


@pytest.fixture
def two(file):
    """The accounts of ann and bob, then each of them with a token."""
    ann, bob = new_user("ann", ["ann"], ["lab"]), new_user("bob")
    keep(file, ann[0], bob[0])
    return Accounts(file), *ann, *bob


def verified(accounts, token):
    return asyncio.run(accounts.verified(token))


def keep(path, *accounts):
    write_users(path, {user.name: user for user in accounts})
    os.utime(path, ns=(os.stat(path).st_mtime_ns + 1,) * 2)  # two writes within a tick of the file system's clock


def test_a_token_is_found_again_and_nothing_like_it(two):
    accounts, ann, token, bob, other = two
    assert verified(accounts, token) == ann and verified(accounts, other) == bob
    swapped = "ann." + other.partition(".")[2]
    for text in (token[:-1], token + "x", swapped, "", "ann", ".", "eve.secret", "\udcff", "a" * 9000):
        assert verified(accounts, text) is None and accounts.known(text) is None
    assert accounts.known(token) == ann and accounts.known(other) == bob


def test_unknown_names_cost_the_same_hash_and_verified_tokens_none(two, monkeypatch):
    accounts, ann, token, *_ = two
    salts, compared = [], []
    hashed, compare = users._hash_token, users.hmac.compare_digest
    monkeypatch.setattr(users, "_hash_token", lambda text, salt: salts.append(salt) or hashed(text, salt))
    monkeypatch.setattr(users.hmac, "compare_digest", lambda a, b: compared.append((len(a), len(b))) or compare(a, b))
    for text in ("eve.secret", "ann.secret", token):
        verified(accounts, text)
    assert len(salts) == 3 and {len(salt) for salt in salts} == {16} and compared == [(32, 32)] * 3
    assert accounts.known(token) == ann and len(salts) == 3


def test_nothing_of_a_token_is_shown_or_kept(two, file, caplog):
    caplog.set_level(logging.DEBUG)
    accounts, ann, token, *_ = two
    for text in (token, token + "x"):
        verified(accounts, text)
    secret = token.partition(".")[2]
    shown = repr(ann) + repr(accounts) + repr(Access(accounts=accounts)) + repr(Rights(accounts)) + caplog.text
    assert secret not in shown and ann.hash.hex() not in shown and str(ann.hash) not in shown
    assert secret not in file.read_text() and all(secret.encode() not in mark for mark in accounts._verified)


def test_the_file_is_read_again_when_it_changes(two, file, caplog):
    accounts, ann, token, bob, other = two
    for text in (token, other):
        verified(accounts, text)
    keep(file, ann)
    assert accounts.known(other) is None and verified(accounts, other) is None
    assert not accounts.holds(bob) and accounts.holds(ann)
    narrow = User("ann", (), (), ann.salt, ann.hash)
    keep(file, narrow)
    assert accounts.known(token) is None and verified(accounts, token) == narrow
    assert not accounts.holds(ann)
    file.write_text("{")
    assert accounts.known(token) == narrow and accounts.known(token) == narrow
    assert [("users.json" in line, line.count("\n")) for line in caplog.messages] == [(True, 0)]
    file.unlink()
    assert accounts.known(token) == narrow and "stay" in caplog.messages[-1]


def test_a_removed_account_is_noticed_while_nobody_comes_in(two, file, monkeypatch):
    accounts, ann, *_ = two
    keep(file)
    assert accounts.holds(ann)  # the file is not looked at for every picture
    monkeypatch.setattr(users, "CHECK_S", 0.0)
    assert not accounts.holds(ann)


def test_a_removal_that_could_not_be_read_is_read_later(two, file, monkeypatch, caplog):
    """Although the file has not changed since."""
    accounts, ann, token, bob, other = two
    assert verified(accounts, other) == bob
    keep(file, ann)
    tries = []

    def fail(*_, **__):
        tries.append(1)
        raise OSError(errno.EMFILE, "Too many open files")

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", fail)
        assert [accounts.known(other) for _ in range(50)] == [bob] * 50 and accounts.holds(bob)
    assert len(tries) == 1 and "Too many open files" in caplog.text  # it is tried once a second
    monkeypatch.setattr(users, "CHECK_S", 0.0)
    assert accounts.known(other) is None and not accounts.holds(bob) and accounts.holds(ann)
    assert verified(accounts, other) is None and verified(accounts, token) == ann


def test_a_change_within_a_tick_of_the_clock_is_seen(two, file, monkeypatch):
    """Of the same size, in place, at what the file system calls the same time."""
    _, ann, token, bob, other = two
    keep(file, ann)
    now = time.time_ns()
    monkeypatch.setattr(users, "_stamp", lambda _: (now, now, 1, 1))
    accounts = Accounts(file)
    assert verified(accounts, token) == ann
    keep(file, bob)
    assert accounts.known(token) is None and verified(accounts, other) == bob


def test_what_is_replaced_while_it_is_read_is_read_again(two, file, monkeypatch):
    accounts, ann, token, bob, _ = two
    assert verified(accounts, token) == ann
    parsed = users._parsed

    def late(path, data):
        found = parsed(path, data)
        if b'"ann"' in data:
            keep(file, bob)
        return found

    keep(file, bob, ann)
    monkeypatch.setattr(users, "_parsed", late)
    monkeypatch.setattr(users, "_CLOCK_STEP_S", -1.0)  # by the stamp alone
    accounts.known(token)
    assert accounts.known(token) is None and not accounts.holds(ann)


def test_a_file_that_is_written_in_pieces_loses_nobody(file, monkeypatch):
    """At no moment does half a file remove or add anybody, and the whole one counts at once."""
    people = [new_user(f"u{number}")[0] for number in range(6)]
    keep(file, *people)
    accounts = Accounts(file)
    keep(file, *people[1:])
    whole = file.read_bytes()
    monkeypatch.setattr(users, "CHECK_S", -1.0)
    with open(file, "wb", buffering=0) as out:
        for start in range(0, len(whole), 97):
            assert all(accounts.holds(one) for one in people)
            out.write(whole[start : start + 97])
    assert not accounts.holds(people[0]) and all(accounts.holds(one) for one in people[1:])


def test_accounts_that_others_can_change_are_said(two, file, caplog):
    """At the start, and when it becomes so while the server runs."""
    accounts, _, token, *_ = two
    assert caplog.messages == []
    os.chmod(file, 0o666)
    accounts.known(token)
    accounts.known(token)
    assert [line.count("expected mode 0600, got 0666") for line in caplog.messages] == [1]
    Accounts(file)
    assert len(caplog.messages) == 2 and str(file) in caplog.messages[-1]


def changed(path, **more):
    data = json.loads(path.read_text())
    data["users"][0] |= more
    path.write_text(json.dumps(data))


BROKEN = {
    "empty": lambda path: path.write_text(""),
    "no object": lambda path: path.write_text("[]"),
    "no text": lambda path: path.write_bytes(b'{"version": 1, "users": "\xff"}'),
    "a later version": lambda path: path.write_text('{"version": 2, "users": []}'),
    "a key that is not known": lambda path: changed(path, admin=True),
    "a path for a name": lambda path: changed(path, name="../ann"),
    "a name with a dot": lambda path: changed(path, name="a.b"),
    "a path for a room": lambda path: changed(path, rooms=["../lab"]),
    "a path for an avatar": lambda path: changed(path, avatars=["..\\ann"]),
    "a short salt": lambda path: changed(path, salt="AAAA"),
    "a hash that is none": lambda path: changed(path, scrypt="?"),
    "twice": lambda path: path.write_text(
        json.dumps((data := json.loads(path.read_text())) | {"users": data["users"] * 2})
    ),
    "large": lambda path: path.write_bytes(b" " * (1 << 20) + b"{}"),
    "nested": lambda path: path.write_text("[" * 100_000),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "away": lambda path: path.unlink(),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_file_is_one_line(file, how):
    ann, _ = new_user("ann")
    keep(file, ann)
    BROKEN[how](file)
    with pytest.raises(FormatError) as caught:
        Accounts(file)
    text = str(caught.value)
    assert text.startswith(str(file)) and text.isprintable() and len(text) < 300 + len(str(file))


@settings(max_examples=150, deadline=None)
@given(data=st.binary(max_size=200) | st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | NAMES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
        st.sampled_from(["version", "users", "name", "salt", "scrypt", "avatars", "rooms"]) | NAMES, inner, max_size=6
    ),
    max_leaves=20,
).map(lambda value: json.dumps(value).encode()))  # fmt: skip
def test_any_file_is_accounts_or_one_line(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "fuzzed.json"
    path.write_bytes(data)
    try:
        assert isinstance(read_users(path), dict)
    except FormatError as error:
        assert str(error).isprintable()


@settings(max_examples=100, deadline=None)
@given(name=NAMES, avatars=st.lists(NAMES, max_size=3), room=NAMES)
def test_any_account_that_can_be_made_is_read_back(tmp_path_factory, name, avatars, room):
    path = tmp_path_factory.getbasetemp() / "made.json"
    try:
        user, token = new_user(name, avatars, [room])
    except GlsplatError as error:
        assert str(error).isprintable()
        return
    write_users(path, {name: user})
    assert read_users(path) == {name: user} and token.partition(".")[0] == name
    assert "/" not in name and path.stat().st_mode & 0o777 == 0o600


def test_no_file_is_written_that_would_not_be_read(file, monkeypatch):
    """One account too many is refused; those that were there stay."""
    ann, bob = (new_user(name)[0] for name in ("ann", "bob"))
    write_users(file, {"ann": ann})
    monkeypatch.setattr(users, "MAX_FILE_BYTES", file.stat().st_size)
    with pytest.raises(FormatError, match="a file of accounts has at most"):
        write_users(file, {"ann": ann, "bob": bob})
    assert read_users(file) == {"ann": ann}


def test_what_an_account_may_do():
    ann = User("ann", ("ann", "default"), ("lab",))
    assert [ann.may_drive(name) for name in ("ann", "default", "bob", "", "*", "../ann")] == [True, True, *[False] * 4]
    assert [ann.may_enter(name) for name in ("lab", "hall", "", "*", "../lab")] == [True, *[False] * 4]
    boss = User("boss")
    paths = ("..", ".", "../lab", "a/b", "a\\b", "", "a\x00", " a", "x" * 65, "\u202e")
    assert boss.may_enter("hall") and boss.may_drive("anything")
    assert not any(boss.may_enter(name) for name in paths)
    nobody = User("eve", (), ())
    assert not nobody.may_drive("default") and not nobody.may_enter("hall")


def test_who_had_an_avatar_made_may_drive_and_delete_it():
    policy = ConsentPolicy(without=True)
    rights = Rights(None, policy)
    policy.add("photo", [OnFile()])
    policy.maker = {"photo": "ann"}.get
    ann, bob, boss = User("ann", ()), User("bob", ("x",)), User("boss")
    assert [rights.sees(user, "avatar", "photo") for user in (None, ann, bob, boss)] == [True, True, False, True]
    assert [rights.may_delete(user, "photo") for user in (None, ann, bob, boss)] == [True, True, False, False]
    policy.maker = lambda avatar: ""
    assert [rights.may_delete(user, "photo") for user in (None, ann, boss)] == [True, False, True]
    assert rights.drivable(bob, ("photo", "x", "y")) == ("x",)


def test_one_token_or_accounts(file):
    keep(file)
    with pytest.raises(GlsplatError, match="not both"):
        Access(token="x" * 16, accounts=Accounts(file))
    assert Access(host="0.0.0.0", tls=True, accounts=Accounts(file)).guarded


def test_the_command(file, capsys):
    def run(*words):
        code = cli.main(["users", *words, "--users", str(file)])
        return code, *capsys.readouterr()

    code, token, said = run("add", "ann", "--avatars", "ann, default", "--rooms", "lab")
    assert code == 0 and token.startswith("ann.") and token.strip() not in said
    assert file.stat().st_mode & 0o777 == 0o600
    assert verified(Accounts(file), token.strip()).avatars == ("ann", "default")
    assert run("add", "bob", "--avatars", "")[0] == 0
    before = file.read_bytes()
    for name in ("ann", "../ann", "a.b", "~a", "", "x" * 33):
        code, out, said = run("add", name)
        assert code != 0 and out == "" and file.read_bytes() == before
    assert run("list")[1] == "ann: avatars ann, default; rooms lab\nbob: avatars none; rooms all\n"
    assert run("remove", "eve")[0] == 2
    assert run("remove", "ann")[0] == 0 and list(read_users(file)) == ["bob"]
