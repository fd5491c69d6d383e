"""A refused handshake is refused for a reason, and the command that failed says which."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from closed_lab import ClosedLab, closed_lab
from polling import PATIENCE_S
from ports import free_port

from nufleet.orchestrator.authority.certificates import (
    Issuer,
    authority_certificate,
    certificate_pem,
    key_pem,
    new_key,
    utc_now,
)
from nufleet.shared.errors import InvalidInputError, NoRouterError
from nufleet.shared.private_files import write_privately
from nufleet.shared.wire import handshake
from nufleet.shared.wire.identity import Identity, address_of, identity_text, read_identity
from nufleet.shared.wire.transport import open_client, open_configured_router, open_router

TRIED_S = 0.4
DAY = timedelta(days=1)


@pytest.fixture(autouse=True)
def _routers_take_their_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handshake, "TIMEOUT_S", PATIENCE_S)
    monkeypatch.setattr(handshake, "ALERT_S", PATIENCE_S)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ClosedLab]:
    with closed_lab(tmp_path_factory.mktemp("closed")) as lab:
        lab.start_router()
        yield lab


@pytest.fixture(scope="module")
def desk(lab: ClosedLab) -> Identity:
    return read_identity(lab.identity("desk"))


def refused(identity: Identity, folder: Path, words: str, key: bytes | None = None) -> None:
    """Store an altered identity with a key, and fail to connect with it for a reason."""
    path = folder / "desk.nufleet"
    write_privately(path.with_suffix(".key"), key or identity.key.read_bytes())
    path.write_text(identity_text(identity))
    with (
        pytest.raises(NoRouterError, match=words),
        open_client(address_of(path), timeout_s=TRIED_S),
    ):
        pass


def test_the_right_identity_connects(lab: ClosedLab) -> None:
    with open_client(address_of(lab.identity("desk")), timeout_s=PATIENCE_S) as session:
        session.check_admitted()
        assert session.principal == "desk"


@pytest.mark.parametrize(
    ("begins", "words"),
    [
        (-10 * DAY, "desk expired on .*clock here is .*`nufleet fleet renew desk`"),
        (2 * DAY, "desk is valid from .* on, and the clock here is .*: set the clock"),
    ],
)
def test_a_certificate_that_is_over_or_of_tomorrow(
    begins: timedelta, words: str, lab: ClosedLab, desk: Identity, tmp_path: Path
) -> None:
    key = new_key()
    made = lab.issuer.issue("desk.1", key.public_key(), utc_now() + begins, 5 * DAY)
    refused(replace(desk, certificate=certificate_pem(made)), tmp_path, words, key_pem(key))


def test_a_certificate_of_another_authority_with_the_right_name(
    desk: Identity, tmp_path: Path
) -> None:
    signer, key = new_key(), new_key()
    other = authority_certificate("lab", signer, utc_now())
    made = Issuer(other, signer).issue("desk.1", key.public_key(), utc_now(), DAY)
    words = "does not know the authority that signed the certificate of desk"
    refused(replace(desk, certificate=certificate_pem(made)), tmp_path, words, key_pem(key))


def test_a_router_of_another_authority(desk: Identity, tmp_path: Path) -> None:
    other = certificate_pem(authority_certificate("lab", new_key(), utc_now()))
    words = "the router's certificate was not made by the authority of fleet lab"
    refused(replace(desk, authority=other), tmp_path, words)


def test_the_certificate_of_the_router_is_no_identity(
    lab: ClosedLab, desk: Identity, tmp_path: Path
) -> None:
    folder = lab.authority.folder / "router"
    stolen = replace(desk, certificate=(folder / "router.pem").read_text())
    words = "the router refuses the certificate of desk"
    refused(stolen, tmp_path, words, (folder / "router.key").read_bytes())


def test_a_router_under_a_name_that_its_certificate_lacks(desk: Identity, tmp_path: Path) -> None:
    elsewhere = replace(desk, router=desk.router.replace("127.0.0.1", "localhost"))
    words = "is for another name than localhost: add it to `addresses`"
    refused(elsewhere, tmp_path, words)


@pytest.mark.parametrize(
    ("begins", "words"),
    [
        (-10 * DAY, "the router's certificate has expired: `nufleet fleet renew --router`"),
        (2 * DAY, "the router's certificate is not yet valid; the clock here is"),
    ],
)
def test_a_router_whose_certificate_is_over_or_of_tomorrow(
    begins: timedelta, words: str, lab: ClosedLab, desk: Identity, tmp_path: Path
) -> None:
    key, now = new_key(), utc_now() + begins
    made = lab.issuer.issue("router", key.public_key(), now, 5 * DAY, serves_at=("127.0.0.1",))
    with false_router(lab, tmp_path, certificate_pem(made), key_pem(key)) as endpoint:
        refused(replace(desk, router=endpoint), tmp_path, words)


def test_a_stolen_robot_cannot_be_the_router(
    lab: ClosedLab, desk: Identity, tmp_path: Path
) -> None:
    """Even with a certificate that holds the router's addresses: its use is another one."""
    robot = read_identity(lab.identity("a"))
    with false_router(lab, tmp_path, robot.certificate, robot.key.read_bytes()) as endpoint:
        refused(
            replace(desk, router=endpoint), tmp_path, "was not made by the authority|unsuitable"
        )


def test_a_port_without_tls(
    desk: Identity, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handshake, "TIMEOUT_S", TRIED_S)  # such a port never answers
    port = free_port()
    with open_router([f"tcp/127.0.0.1:{port}"]):
        elsewhere = replace(desk, router=f"tls/127.0.0.1:{port}")
        refused(elsewhere, tmp_path, "the port does not speak TLS")


def test_a_port_on_which_nothing_listens(desk: Identity, tmp_path: Path) -> None:
    elsewhere = replace(desk, router=f"tls/127.0.0.1:{free_port()}")
    refused(elsewhere, tmp_path, "no program listens at 127.0.0.1, port .*: start the router")


def test_a_router_that_has_no_address(desk: Identity, tmp_path: Path) -> None:
    elsewhere = replace(desk, router="tls/no-such-host.invalid:7447")
    refused(elsewhere, tmp_path, "the name no-such-host.invalid of the router is unknown here")


def test_a_key_of_another_certificate(desk: Identity, tmp_path: Path) -> None:
    refused(desk, tmp_path, "does not fit the key", key_pem(new_key()))


@pytest.mark.parametrize("endpoint", ["tcp", "tls"])
def test_an_outsider_without_an_identity_does_not_get_in(lab: ClosedLab, endpoint: str) -> None:
    address = read_identity(lab.identity("desk")).router.replace("tls/", f"{endpoint}/")
    with pytest.raises(NoRouterError), open_client(address, timeout_s=TRIED_S):
        pass


@contextmanager
def false_router(lab: ClosedLab, folder: Path, certificate: str, key: bytes) -> Iterator[str]:
    """A router like the fleet's own on another port, with a certificate and key of choice."""
    port = free_port()
    text = lab.authority.configuration.read_text()
    own = read_identity(lab.identity("desk")).router
    endpoint = f"tls/127.0.0.1:{port}"
    (folder / "router.json5").write_text(text.replace(own, endpoint))
    (folder / "router.pem").write_text(certificate)
    write_privately(folder / "router.key", key)
    authority = (lab.authority.folder / "authority.pem").read_text()
    (folder / "authority.pem").write_text(authority)
    with open_configured_router(folder / "router.json5", allow_open=False):
        yield endpoint


def test_a_router_that_others_could_enter_or_whose_key_they_can_read_does_not_start(
    lab: ClosedLab, tmp_path: Path
) -> None:
    folder = tmp_path / "router"
    shutil.copytree(lab.authority.folder / "router", folder)
    configuration = folder / "router.json5"
    text = configuration.read_text()
    linked = text.replace('"listen": {', '"connect": {"endpoints": ["tcp/base:7447"]}, "listen": {')
    everyones = text.replace("tls/127.0.0.1", "tls/0.0.0.0").replace(
        '"enable_mtls": true', '"enable_mtls": false'
    )
    for changed, mode, words in (
        (text, 0o640, r"can read or replace the key .*router\.key: chmod 600"),
        (linked, 0o600, "tcp/base:7447 is open"),
        (everyones, 0o600, "tls/0.0.0.0:.* is open: every machine"),
        (text.replace("router.key", "gone.key"), 0o600, r"gone\.key: cannot be read"),
    ):
        configuration.write_text(changed)
        (folder / "router.key").chmod(mode)
        opening = open_configured_router(configuration, allow_open=False)
        with pytest.raises(InvalidInputError, match=words), opening:
            pass
