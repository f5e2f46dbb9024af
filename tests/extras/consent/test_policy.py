"""Who may be shown and who may drive, at a time."""

from __future__ import annotations

import pickle
from datetime import UTC, datetime

import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.consent.file import OnFile, on_file, on_file_data, sign_data
from glsplat.extras.consent.policy import ConsentPolicy
from tests.extras.consent.conftest import DURING, FIELDS


def at(text):
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


@pytest.fixture
def ann(signed):
    return on_file(signed)


def test_a_valid_record_lets_its_drivers(ann):
    policy = ConsentPolicy()
    policy.add("ann", [ann])
    assert policy.refusal("ann", "ann", DURING) is None
    for stranger in ("bob", "", "*", "Ann"):
        assert "that is not you" in policy.refusal("ann", stranger, DURING)
    assert policy.label("ann") == "" and policy.check("ann", DURING) is None


def test_the_last_day_counts_and_no_second_more(ann):
    policy = ConsentPolicy()
    policy.add("ann", [ann])
    assert policy.refusal("ann", "ann", at("2026-05-01T00:00:00")) is None
    assert policy.refusal("ann", "ann", at("2026-05-31T23:59:59")) is None
    assert "begins on 2026-05-01" in policy.refusal("ann", "ann", at("2026-04-30T23:59:59"))
    assert "ended on 2026-05-31" in policy.refusal("ann", "ann", at("2026-06-01T00:00:00"))


def test_keys_that_are_trusted(ann, key):
    asked = ConsentPolicy(trusted=["0" * 64])
    asked.add("ann", [ann])
    assert "which this server does not trust" in asked.refusal("ann", "ann", DURING)
    with pytest.raises(GlsplatError, match="without-consent = true"):
        asked.check("ann", DURING)
    for policy in (ConsentPolicy(trusted=[key.public]), asked):
        policy.add("ann", [ann])
        policy.trust_own(key.public)
        assert policy.refusal("ann", "ann", DURING) is None
    nobody = ConsentPolicy(trusted=[])
    nobody.add("ann", [ann])
    assert nobody.refusal("ann", "ann", DURING)


def test_without_consent_it_is_shown_and_said(ann):
    policy = ConsentPolicy(without=True)
    policy.add("ann", [ann])
    policy.add("bob", [OnFile(fault="no consent on file")])
    policy.add("room", [])
    for name in ("ann", "bob", "room", "unheard of"):
        assert policy.refusal(name, "", DURING) is None
    said = {name: policy.label(name, "ann", DURING) for name in ("ann", "bob", "room", "unheard of")}
    assert said == {"ann": "", "bob": "no consent on file", "room": "", "unheard of": "no consent on file"}
    assert policy.label("ann", "bob", DURING) == policy.label("ann") == "no consent on file"
    assert pickle.loads(pickle.dumps(policy)).label("bob") == "no consent on file"  # in the process that draws


def test_all_people_of_a_scene_are_asked_for(ann):
    policy = ConsentPolicy()
    policy.add("party", [ann, OnFile(nobody=True)], driven=False)
    assert policy.refusal("party", "", DURING) is None
    policy.add("party", [OnFile(nobody=True), ann, OnFile(fault="no consent on file")], driven=False)
    assert "no consent on file" in policy.refusal("party", "", DURING)
    policy.add("room", [])
    assert policy.refusal("room", "", DURING) is None
    assert "no consent" in policy.refusal("unheard of", "ann", DURING)


def test_splats_are_withheld_unless_every_record_hands_them_out(file, signed, key):
    given = on_file_data(sign_data(file.read_bytes(), key, **FIELDS, hand_out=True))
    policy, lax = ConsentPolicy(), ConsentPolicy(without=True)
    for one in (policy, lax):
        one.add("ann", [on_file(signed)])
        one.add("bob", [given])
        one.add("both", [given, on_file(signed)])
        one.add("nobody", [OnFile(nobody=True)])
        one.add("unsigned", [OnFile(fault="no consent on file")])
        assert one.withheld("bob", DURING) is None and one.withheld("nobody", DURING) is None
        for name in ("ann", "both"):
            assert "not to hand out its splats" in one.withheld(name, DURING)
        for name in ("unsigned", "never heard of"):
            assert "no consent on file" in one.withheld(name, DURING)
        assert "ended on 2026-05-31" in one.withheld("bob", at("2026-06-01T00:00:00"))
    stranger = ConsentPolicy(trusted=["0" * 64])
    stranger.add("bob", [given])
    assert "does not trust" in stranger.withheld("bob", DURING)


def test_what_an_operator_is_told(ann, key):
    policy = ConsentPolicy()
    policy.add("ann", [ann])
    told = policy.doubts("ann", accounts=False)
    assert key.public[:16] in told[0] and "trust = " in told[0] and "--users" in told[1] and len(told) == 2
    assert ConsentPolicy(trusted=[key.public]).doubts("ann", accounts=True) == []
    assert policy.maker("ann") == ""
    policy.trust_own(key.public)
    assert policy.doubts("ann", accounts=True) == [] and policy.maker("ann") == "Ann Example"
