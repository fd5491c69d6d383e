"""An identity file is checked before it is used, and says what is wrong with it."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from nufleet.shared.wire.identity import (
    Identity,
    IdentityError,
    address_of,
    found_identities,
    identity_at,
    identity_text,
    read_identity,
)

PEM = "-----BEGIN CERTIFICATE-----\nMA==\n-----END CERTIFICATE-----\n"


@pytest.fixture
def identity(tmp_path: Path) -> Identity:
    path = tmp_path / "desk.nufleet"
    identity = Identity(path, "lab", "desk", "orchestrator", "tls/base:7447", PEM, PEM)
    path.write_text(identity_text(identity))
    identity.key.touch(mode=0o600)
    return identity


def test_what_is_written_is_read(identity: Identity) -> None:
    assert read_identity(identity.path) == identity
    assert identity_at(address_of(identity.path)) == identity
    assert identity_at("tcp/127.0.0.1:7447") is None


def test_the_first_certificate_of_the_file_is_the_principals_own(identity: Identity) -> None:
    text = identity_text(replace(identity, certificate=PEM.replace("MA", "OWN")))
    assert text.index("OWN") < text.index("authority")
    assert tomllib.loads(text)["principal"] == "desk"


def test_settings_for_zenoh_name_the_key_and_do_not_hold_it(identity: Identity) -> None:
    identity.key.write_text("SECRET")
    settings = identity.zenoh_settings()
    assert "SECRET" not in repr(settings)
    assert settings["connect_private_key"] == str(identity.key)
    assert (settings["enable_mtls"], settings["verify_name_on_connect"]) == (True, True)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("schema = 1", "schema = 2", "schema 1 was expected"),
        ("schema = 1", "", "schema 1 was expected"),
        ('role = "orchestrator"\n', "", "wrong or missing: role"),
        ("schema = 1", 'schema = 1\nfriend = "x"', "wrong or missing: friend"),
        ('fleet = "lab"', "fleet = 3", "wrong or missing: fleet"),
        ('"lab"', '"la b"', "fleet, principal, role or router is not valid"),
        ('"desk"', '"*"', "fleet, principal, role or router is not valid"),
        ('"orchestrator"', '"owner"', "fleet, principal, role or router is not valid"),
        ("tls/base", "tcp/base", "fleet, principal, role or router is not valid"),
        (":7447", "", "fleet, principal, role or router is not valid"),
        (":7447", ":7447#verify_name_on_connect=false", "role or router is not valid"),
        ("BEGIN", "BEGINNING", "a certificate is not in PEM"),
        ("schema", "=", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_named_with_what_is_wrong(
    old: str, new: str, words: str, identity: Identity
) -> None:
    identity.path.write_text(identity.path.read_text().replace(old, new))
    with pytest.raises(IdentityError, match=words) as raised:
        read_identity(identity.path)
    assert str(identity.path) in str(raised.value)


def test_a_missing_identity_or_key_is_named(identity: Identity, tmp_path: Path) -> None:
    with pytest.raises(IdentityError, match=r"none\.nufleet: cannot be read"):
        read_identity(tmp_path / "none.nufleet")
    identity.key.unlink()
    with pytest.raises(IdentityError, match=r"the key of .* is missing: .*desk\.key"):
        read_identity(identity.path)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602])
def test_a_key_that_others_may_read_or_replace_is_refused(mode: int, identity: Identity) -> None:
    identity.key.chmod(mode)
    with pytest.raises(IdentityError, match=r"other users can .* chmod 600 .*desk\.key"):
        read_identity(identity.path)


def test_the_identities_of_the_user_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert found_identities() == ()
    folder = tmp_path / "nufleet"
    folder.mkdir()
    (folder / "desk.nufleet").touch()
    (folder / "anna.nufleet").touch()
    assert found_identities() == (folder / "anna.nufleet", folder / "desk.nufleet")
