"""A record in a file: signed, verified, refused for anything else than what was signed."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import replace
from datetime import date

import numpy as np
import pytest

import glsplat
from glsplat.data import embedded_file
from glsplat.errors import FormatError
from glsplat.extras.consent.document import read_record, signed_record
from glsplat.extras.consent.file import on_file, on_file_data, sign_data, sign_file
from glsplat.extras.consent.keys import new_key, private_key, public_key, signature_of
from glsplat.extras.consent.record import canonical
from glsplat.skinning.shapes import Shapes
from glsplat.splats import Level
from tests.extras.consent.conftest import FIELDS, person


def parts(data):
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[20 + size :]


def put(document, rest):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def note(document):
    return document["asset"]["extras"]["glsplat"]


def test_what_was_signed_is_on_file_and_nothing_else_changed(file, key):
    before = file.read_bytes()
    sign_file(file, file, key, **FIELDS)
    found = on_file(file)
    assert found.fault == "" and not found.nobody
    consent = found.consent
    assert (consent.subject, consent.given_by, consent.purpose) == ("Ann Example", "Ann Example", "a study of May")
    assert consent.key == key.public and consent.drivers == {"ann"}
    (old, old_rest), (new, new_rest) = parts(before), parts(file.read_bytes())
    record = note(new).pop("consent")
    assert old_rest == new_rest and old == new
    assert set(record) == {
        *("subject", "given_by", "purpose", "from", "until", "drivers"),
        *("splats_sha256", "file_sha256", "key", "signature"),
    }
    assert (record["from"], record["until"]) == ("2026-05-01", "2026-05-31")
    loaded = glsplat.load(file)
    assert np.array_equal(loaded.splats.means, person().splats.means)


def test_any_altered_bit_is_noticed(key, tmp_path):
    """Header, JSON, record, binary chunk: of every fifth byte the lowest bit.

    Where a number is the same with another last digit, nothing was altered.
    """
    glsplat.save(person(count=3), tmp_path / "a.glb")
    data = bytearray(sign_data((tmp_path / "a.glb").read_bytes(), key, **FIELDS))
    signed = bytes(data)
    assert on_file_data(signed).fault == ""
    refused = 0
    for at in range(4, len(data), 5):
        data[at] ^= 1
        fault = on_file_data(bytes(data)).fault
        assert fault or parts(bytes(data)) == parts(signed), f"byte {at} of {len(data)}"
        refused += bool(fault)
        data[at] ^= 1
    assert refused > 0.99 * (len(data) - 4) / 5


def test_an_altered_record_is_refused_and_holds_for_no_other_avatar(signed, key, tmp_path):
    document, rest = parts(signed.read_bytes())
    record = note(document)["consent"]
    value = {"subject": "Bob", "until": "2036-05-31", "drivers": ["*"], "splats_sha256": "0" * 64}
    for change in (value | {"key": new_key(tmp_path / "other").public}).items():
        note(document)["consent"] = record | dict([change])
        assert "signature does not fit" in on_file_data(put(document, rest)).fault
    glsplat.save(person(seed=1), tmp_path / "bob.glb")
    document, rest = parts((tmp_path / "bob.glb").read_bytes())
    note(document)["consent"] = record
    assert "changed after it was signed" in on_file_data(put(document, rest)).fault


def record_of(data, key, **changed):
    """The record of a file, some fields of it changed and signed anew."""
    record = note(parts(data)[0])["consent"] | changed
    record = {name: value for name, value in record.items() if value is not None and name != "signature"}
    return record | {"signature": signature_of(key, canonical(record))}


def test_a_coarser_level_is_bound_too(key, tmp_path):
    """Else somebody else's would be shown from afar. Without file_sha256 a record holds for a single level only."""
    one, other = person(), person(seed=1, count=10)
    for name, coarse in (("a", person(count=10)), ("b", replace(other, skeleton=one.skeleton))):
        glsplat.save(replace(one, levels=(Level(replace(coarse, levels=()), 100.0, 30.0),)), tmp_path / f"{name}.glb")
    signed = sign_data((tmp_path / "a.glb").read_bytes(), key, **FIELDS)
    assert on_file_data(signed).fault == ""
    document, rest = parts((tmp_path / "b.glb").read_bytes())
    note(document)["consent"] = note(parts(signed)[0])["consent"]
    assert "changed after it was signed" in on_file_data(put(document, rest)).fault
    note(document)["consent"] = record_of(signed, key, file_sha256=None)
    assert "does not cover" in on_file_data(put(document, rest)).fault


def test_signing_replaces_what_was_there_and_needs_a_glb(file, key):
    document, rest = parts(file.read_bytes())
    assert on_file_data(put(document, rest)).fault == "no consent on file"
    note(document)["consent"] = "my own"  # a line of text is none
    assert on_file_data(put(document, rest)).fault == "no consent on file"
    assert on_file_data(sign_data(put(document, rest), key, **FIELDS)).fault == ""
    del document["asset"]["extras"]
    once = sign_data(put(document, rest), key, **FIELDS)
    assert on_file_data(sign_data(once, key, **FIELDS | {"until": date(2027, 1, 1)})).fault == ""
    for data, why in ((b"ply\n", "in .glb files alone"), (put(document, rest)[:50], "truncated")):
        with pytest.raises(FormatError, match=why):
            sign_data(data, key, **FIELDS)
    document["buffers"][0]["uri"] = "other.bin"
    with pytest.raises(FormatError, match="files of their own"):
        sign_data(put(document, rest), key, **FIELDS)


def test_it_survives_saving_and_is_left_out_with_a_word_where_the_file_is_another(signed, tmp_path, caplog):
    avatar = glsplat.load(signed)
    glsplat.save(avatar, tmp_path / "again.glb")
    assert on_file(tmp_path / "again.glb").fault == "" and not caplog.records
    coarse = replace(avatar, splats=avatar.splats.take(range(5)), skin=avatar.skin.take(range(5)))
    for name, other in {
        "splats.glb": replace(avatar, splats=replace(avatar.splats, opacities=avatar.splats.opacities * 0.5)),
        "levels.glb": replace(avatar, levels=(Level(coarse, 100.0),)),
        "cones.glb": replace(avatar, splats=replace(avatar.splats, cones=np.zeros((30, 4), np.int8))),
        "notes.glb": replace(avatar, meta={**avatar.meta, "licence": "CC0-1.0"}),
        "out.gltf": avatar,
    }.items():
        caplog.clear()
        glsplat.save(other, tmp_path / name)
        assert "consent" not in glsplat.load(tmp_path / name).meta
        (line,) = caplog.messages
        assert name in line and "the consent is left out" in line


def test_what_comes_with_glsplat_shows_nobody(tmp_path):
    data = embedded_file("ben").read_bytes()
    copy = tmp_path / "copy.glb"
    copy.write_bytes(data)
    assert on_file(copy).nobody
    copy.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert not on_file(copy).nobody and on_file(copy).fault == "no consent on file"


STRANGE = {
    "no object": ("mine", "not a record"),
    "a key that is not known": ({"rooms": ["a"]}, "'rooms', which this version does not know"),
    "a date": ({"until": "soon"}, "'until' needs a date"),
    "no such day": ({"until": "2026-02-30"}, "'until' needs a date"),
    "backwards": ({"until": "2026-04-30"}, "ends .* before it begins"),
    "nobody drives": ({"drivers": []}, "drivers need a list"),
    "a number": ({"subject": 3}, "subject needs"),
    "control characters": ({"purpose": "a\x1b[2J"}, "purpose needs"),
    "no text": ({"purpose": "\ud800"}, "purpose needs"),
    "an upper case key": ({"key": "A" * 64}, "key needs 64 digits"),
    "handing out": ({"hand_out": 1}, "hand_out needs true or false"),
    "a weak key": ({"key": "0" * 64}, "signature does not fit"),
}


def test_strange_records_are_refused_in_one_line(key):
    good = signed_record(key, splats_sha256="0" * 64, file_sha256=None, **FIELDS)
    read_record(good)
    lacking = {name: value for name, value in good.items() if name != "purpose"}
    for change, why in (*STRANGE.values(), (None, "lacks")):
        record = lacking if change is None else change if isinstance(change, str) else good | change
        with pytest.raises(FormatError, match=why) as caught:
            read_record(record)
        assert str(caught.value).isprintable()


def test_a_record_can_be_checked_by_others(key):
    """RFC 8032 over sorted JSON without spaces, all but the signature: nothing of ours is needed."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    record = signed_record(key, splats_sha256="0" * 64, file_sha256=None, **FIELDS | {"subject": "Åsa"})
    signature = bytes.fromhex(record.pop("signature"))
    text = "{" + ",".join(
        f"{json.dumps(name)}:{json.dumps(record[name], ensure_ascii=False)}" for name in sorted(record)
    )
    Ed25519PublicKey.from_public_bytes(bytes.fromhex(record["key"])).verify(signature, (text + "}").encode())


def test_keys_are_private_and_never_written_over(tmp_path):
    path = tmp_path / "key"
    made = new_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert private_key(path).public == made.public == public_key(tmp_path / "key.pub")
    assert repr(made.secret) not in repr(made)
    before = path.read_bytes()
    with pytest.raises(FormatError, match="never written over"):
        new_key(path)
    path.unlink()
    with pytest.raises(FormatError, match=r"key\.pub: exists"):
        new_key(path)
    assert not path.exists()
    path.write_bytes(before)
    with pytest.raises(FormatError, match="a private key; give the public one"):
        public_key(path)
    (tmp_path / "line").write_text(made.public + "\n")
    assert public_key(tmp_path / "line") == made.public
    for reader in (private_key, public_key):
        (tmp_path / "junk").write_bytes(b"\xff junk")
        with pytest.raises(FormatError, match="junk: expected an Ed25519"):
            reader(tmp_path / "junk")


def test_the_hashes_can_be_taken_by_others(signed):
    """As docs/consent.md says, with nothing of ours."""
    document, rest = parts(signed.read_bytes())
    record = note(document).pop("consent")
    chunk, arrays = rest[8:], hashlib.sha256()
    for index in document["meshes"][0]["primitives"][0]["attributes"].values():
        view = document["bufferViews"][document["accessors"][index]["bufferView"]]
        arrays.update(chunk[view.get("byteOffset", 0) :][: view["byteLength"]])
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
    assert record["splats_sha256"] == arrays.hexdigest()
    assert record["file_sha256"] == hashlib.sha256(text + b"\0" + rest).hexdigest()


def test_handing_out_the_splats_is_said_in_the_record_alone_and_cannot_be_added_later(file, key):
    plain, given = (sign_data(file.read_bytes(), key, **FIELDS, hand_out=hand_out) for hand_out in (False, True))
    assert "hand_out" not in note(parts(plain)[0])["consent"]  # which older versions read
    assert not on_file_data(plain).hands_out and on_file_data(given).hands_out
    document, rest = parts(plain)
    note(document)["consent"]["hand_out"] = True
    forged = on_file_data(put(document, rest))
    assert not forged.hands_out and "signature does not fit" in forged.fault
    assert on_file(embedded_file("ben")).hands_out  # nobody is shown


def test_an_avatar_with_expressions_carries_one_too(key, tmp_path):
    """Its splats have attributes that are zeros but for what a shape does: accessors without data."""
    avatar, path = person(), tmp_path / "face.glb"
    bends = np.full((2, 2, 3), 0.3)
    shapes = Shapes.create(["jawOpen"], 30, splats=[1, 2], targets=[0, 0], moves=np.full((2, 3), 0.01), bends=bends)
    glsplat.save(replace(avatar, shapes=shapes), path)
    data = sign_data(path.read_bytes(), key, **FIELDS)
    assert on_file_data(data).consent is not None and b'"_AXIS_0"' in data
    document, rest = parts(data)
    zeros = [k for k, one in enumerate(document["accessors"]) if "bufferView" not in one and "sparse" not in one]
    assert zeros
    document["accessors"][zeros[0]]["componentType"] = 5121
    assert on_file_data(put(document, rest)).fault
