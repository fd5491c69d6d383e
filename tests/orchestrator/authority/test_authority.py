"""An authority's folder: what enrolling, renewing and revoking write, and what they refuse."""

from __future__ import annotations

import base64
import json
import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from nufleet.orchestrator.authority.authority import Authority
from nufleet.orchestrator.authority.key_files import make_request
from nufleet.shared.errors import FleetFileError, InvalidInputError
from nufleet.shared.wire.identity import read_identity

INVENTORY = """
schema = 1
name = "lab"
[router]
addresses = ["127.0.0.1", "base.example"]
[orchestrators.desk]
[operators.anna]
[watchers.screen]
[robots.a]
driver = "double_integrator"
"""


@pytest.fixture
def inventory(tmp_path: Path) -> Path:
    path = tmp_path / "lab.toml"
    path.write_text(INVENTORY)
    return path


@pytest.fixture
def authority(inventory: Path, tmp_path: Path) -> Authority:
    return Authority.create(inventory, tmp_path / "lab.authority")


def common_name(identity: Path) -> str:
    certificate = x509.load_pem_x509_certificate(read_identity(identity).certificate.encode())
    return str(certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def listed(authority: Authority) -> set[str]:
    text = authority.configuration.read_text()
    document = json.loads("\n".join(ln for ln in text.splitlines() if not ln.startswith("//")))
    subjects = document["access_control"]["subjects"]
    return {name for subject in subjects for name in subject["cert_common_names"]}


def foreign(folder: Path) -> Path:
    """A request for a kind of key that cryptography does not know."""
    request = make_request("x", folder)[1]
    der = x509.load_pem_x509_csr(request.read_bytes()).public_bytes(Encoding.DER)
    unknown = base64.b64encode(der.replace(b"\x2b\x65\x70", b"\x2b\x65\x7f")).decode()
    head, *_, foot = request.read_text().splitlines()
    request.write_text(f"{head}\n{unknown}\n{foot}\n")
    return request


def test_every_file_is_private(authority: Authority, tmp_path: Path) -> None:
    authority.enroll("a", tmp_path / "ids")
    for path in tmp_path.rglob("*"):
        if path.name != "lab.toml":
            assert stat.S_IMODE(path.stat().st_mode) & 0o077 == 0, path


def test_an_identity_holds_what_its_principal_needs_and_no_key(
    authority: Authority, tmp_path: Path
) -> None:
    enrolled = authority.enroll("desk", tmp_path)
    identity = read_identity(enrolled.identity)
    assert (identity.fleet, identity.principal, identity.role) == ("lab", "desk", "orchestrator")
    assert identity.router == "tls/127.0.0.1:7447"
    assert "PRIVATE" not in enrolled.identity.read_text()
    assert enrolled.key == identity.key


def test_a_request_keeps_the_key_where_it_was_made(authority: Authority, tmp_path: Path) -> None:
    key, request = make_request("a", tmp_path / "robot")
    assert authority.enroll("a", tmp_path / "base", request=request).key is None
    assert not (tmp_path / "base" / "a.key").exists()
    (tmp_path / "robot" / "a.nufleet").write_bytes((tmp_path / "base" / "a.nufleet").read_bytes())
    assert read_identity(tmp_path / "robot" / "a.nufleet").key == key


def test_all_of_the_inventory_are_listed_from_the_beginning(authority: Authority) -> None:
    assert listed(authority) == {"desk.1", "anna.1", "screen.1", "a.1"}


def test_a_revoked_certificate_is_not_listed_again_with_the_next_one(
    authority: Authority, tmp_path: Path
) -> None:
    authority.enroll("a", tmp_path / "first")
    authority.revoke("a")
    assert listed(authority) == {"desk.1", "anna.1", "screen.1", "a.2"}
    again = Authority(authority.folder).enroll("a", tmp_path / "second")
    assert common_name(again.identity) == "a.2"
    assert not again.router_changed


def test_renewing_keeps_key_and_name_and_changes_the_certificate(
    authority: Authority, tmp_path: Path
) -> None:
    first = authority.enroll("a", tmp_path, days=1)
    before, key = read_identity(first.identity), first.key
    assert key is not None
    secret = key.read_bytes()
    second = authority.renew("a", tmp_path)
    assert second.expires > first.expires
    assert read_identity(second.identity).certificate != before.certificate
    assert common_name(second.identity) == "a.1"
    assert key.read_bytes() == secret


def test_a_principal_that_is_added_later_needs_a_restart_of_the_router(
    authority: Authority, inventory: Path, tmp_path: Path
) -> None:
    inventory.write_text(f"{INVENTORY}[robots.b]\ndriver = 'double_integrator'\n")
    enrolled = Authority(authority.folder).enroll("b", tmp_path)
    assert enrolled.router_changed
    assert "b.1" in listed(authority)


def test_an_authority_is_never_replaced(authority: Authority, inventory: Path) -> None:
    key = (authority.folder / "authority.key").read_bytes()
    with pytest.raises(InvalidInputError, match="an authority is never replaced"):
        Authority.create(inventory, authority.folder)
    assert (authority.folder / "authority.key").read_bytes() == key


def test_what_one_command_revoked_stays_revoked_when_another_enrols_at_the_same_time(
    authority: Authority, tmp_path: Path
) -> None:
    authority.enroll("a", tmp_path)
    first, second = Authority(authority.folder), Authority(authority.folder)
    first.revoke("a")
    second.enroll("desk", tmp_path)
    assert listed(authority) == {"desk.1", "anna.1", "screen.1", "a.2"}
    assert Authority(authority.folder).ledger.enrolments["a"].revoked


def test_an_identity_that_could_not_be_written_can_be_revoked(
    authority: Authority, tmp_path: Path
) -> None:
    (tmp_path / "a.nufleet").mkdir()
    with pytest.raises(InvalidInputError, match=r"a\.nufleet"):
        authority.enroll("a", tmp_path)
    Authority(authority.folder).revoke("a")
    assert "a.2" in listed(authority)


def test_a_folder_that_was_there_keeps_its_mode(authority: Authority, tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir(mode=0o755)
    authority.enroll("a", tmp_path / "shared")
    make_request("b", tmp_path / "shared")
    assert stat.S_IMODE((tmp_path / "shared").stat().st_mode) == 0o755


def test_the_inventory_may_move_with_the_folder(
    authority: Authority, inventory: Path, tmp_path: Path
) -> None:
    stick = tmp_path / "stick"
    stick.mkdir()
    moved = authority.folder.rename(stick / "lab.authority")
    inventory.rename(stick / "lab.toml")
    assert Authority(moved).enroll("a", tmp_path).identity.exists()
    (stick / "lab.toml").unlink()
    with pytest.raises(InvalidInputError, match=r"the inventory of .* is neither .*lab\.toml nor "):
        Authority(moved)


def test_the_routers_configuration_is_written_again_if_it_is_missing(
    authority: Authority, tmp_path: Path
) -> None:
    authority.configuration.unlink()
    assert authority.enroll("a", tmp_path).router_changed
    assert "a.1" in listed(authority)


def test_an_authority_is_replaced_while_both_are_trusted(
    authority: Authority, tmp_path: Path
) -> None:
    for name in ("desk", "anna", "screen"):
        authority.enroll(name, tmp_path)
    authority.revoke("screen")
    before = read_identity(tmp_path / "desk.nufleet").authority
    authority.replace()
    served = authority.folder / "router" / "authority.pem"
    assert served.read_text().count("BEGIN") == 2
    assert served.read_text().endswith(before)
    again = Authority(authority.folder)
    assert again.replaced
    with pytest.raises(InvalidInputError, match="the authority is being replaced"):
        again.renew_router()
    again.renew("desk", tmp_path)
    assert read_identity(tmp_path / "desk.nufleet").authority == served.read_text()
    with pytest.raises(InvalidInputError, match=r"^anna: signed by the former authority"):
        again.finish_replacing()
    assert served.read_text().count("BEGIN") == 2
    again.renew("anna", tmp_path)
    again.finish_replacing()
    assert not Authority(authority.folder).replaced
    assert served.read_text() == (authority.folder / "authority.pem").read_text()
    assert served.read_text().count("BEGIN") == 1
    assert served.read_text() != before


def test_a_replacement_that_was_cut_off_before_its_key_was_written_can_be_begun_again(
    authority: Authority, tmp_path: Path
) -> None:
    key = (authority.folder / "authority.key").read_bytes()
    authority.replace()
    (authority.folder / "authority.key").write_bytes(key)
    again = Authority(authority.folder)
    enrolled = again.enroll("desk", tmp_path)
    again.finish_replacing()
    assert not Authority(authority.folder).replaced
    pem = (authority.folder / "router" / "authority.pem").read_bytes()
    trusted = x509.load_pem_x509_certificate(pem)
    made = x509.load_pem_x509_certificate(read_identity(enrolled.identity).certificate.encode())
    made.verify_directly_issued_by(trusted)


def test_a_key_is_never_replaced(authority: Authority, tmp_path: Path) -> None:
    key, _ = make_request("a", tmp_path)
    secret = key.read_bytes()
    with pytest.raises(InvalidInputError, match=r"a\.key exists, and a key is never replaced"):
        make_request("a", tmp_path)
    with pytest.raises(InvalidInputError, match=r"a\.key exists, and a key is never replaced"):
        authority.enroll("a", tmp_path)
    assert key.read_bytes() == secret
    assert "a" not in Authority(authority.folder).ledger.enrolments


@pytest.mark.parametrize(
    ("do", "words"),
    [
        (lambda it, at: it.enroll("ghost", at), "ghost is not in the inventory .*add it there"),
        (lambda it, at: it.enroll("desk", at / "x"), "desk is enrolled until .*fleet renew desk"),
        (lambda it, at: it.renew("anna", at), "anna has never been enrolled"),
        (lambda it, at: it.revoke("anna"), "anna is not enrolled; enrolled are desk"),
        (lambda it, at: it.enroll("a", at, request=at / "none"), "none: cannot be read"),
        (lambda it, at: it.enroll("a", at, request=at / "lab.toml"), "is not a request of"),
        (lambda it, at: it.enroll("a", at, request=foreign(at)), "is not a request of"),
        (lambda it, at: it.enroll("a", at / "lab.toml" / "x"), r"lab\.toml.*: Not a directory"),
        (
            lambda it, at: it.enroll("a", at, request=make_request("screen", at)[1]),
            r"screen\.request is a request of screen, not of a",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_in_a_sentence(
    do: object, words: str, authority: Authority, tmp_path: Path
) -> None:
    authority.enroll("desk", tmp_path)
    ledger = (authority.folder / "issued.json").read_bytes()
    with pytest.raises(InvalidInputError, match=words):
        do(authority, tmp_path)  # type: ignore[operator]
    assert (authority.folder / "issued.json").read_bytes() == ledger


def test_an_altered_request_is_refused(authority: Authority, tmp_path: Path) -> None:
    _, request = make_request("a", tmp_path)
    lines = request.read_text().splitlines()
    middle = lines[1]
    lines[1] = middle[:-8] + ("A" if middle[-8] != "A" else "B") + middle[-7:]
    request.write_text("\n".join(lines))
    with pytest.raises(InvalidInputError, match=r"a\.request"):
        authority.enroll("a", tmp_path, request=request)


def test_a_key_of_the_authority_that_others_can_read_is_not_used(authority: Authority) -> None:
    (authority.folder / "authority.key").chmod(0o644)
    with pytest.raises(InvalidInputError, match=r"can read or replace the key .*chmod 600"):
        Authority(authority.folder)


@pytest.mark.parametrize(
    ("added", "words"),
    [
        ("[operators.desk]", r"lab\.toml: desk is listed in two roles"),
        ("[watchers.a]", "a is listed in two roles"),
        (f"[watchers.{'w' * 51}]", "too long for a certificate: at most 50"),
        ("[pilots.anna]", "pilots"),
        ("[operators.eve]\nmay_fly = true", "may_fly"),
        ("[watchers.'Big Screen']", "watchers"),
        ("[orchestrators.desk]", "not valid TOML"),
    ],
)
def test_a_wrong_inventory_is_refused_before_anything_is_made(
    added: str, words: str, inventory: Path, tmp_path: Path
) -> None:
    inventory.write_text(f"{INVENTORY}{added}\n")
    with pytest.raises(FleetFileError, match=words):
        Authority.create(inventory, tmp_path / "lab.authority")
    assert not (tmp_path / "lab.authority").exists()


def test_an_inventory_without_a_router_gets_an_example(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text('schema = 1\nname = "lab"\n[robots.a]\ndriver = "double_integrator"\n')
    with pytest.raises(InvalidInputError, match=r"(?s)where the fleet's router is.*addresses = "):
        Authority.create(path, tmp_path / "lab.authority")


def test_a_folder_that_is_no_authority_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="is not the folder of an authority"):
        Authority(tmp_path)
