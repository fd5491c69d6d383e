"""What lets other machines in without proof is refused unless it is asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.wire.identity import Identity, IdentityError, identity_text
from nufleet.shared.wire.openness import (
    LOCAL_ENDPOINT,
    check_closed,
    chosen_address,
    chosen_addresses,
    is_open,
)

CLOSED = (
    *("tcp/127.0.0.1:7447", "tcp/127.1.2.3:1", "tcp/[::1]:7447", "tcp/localhost:7447"),
    *("unixsock-stream//tmp/r.sock", "tls/192.168.1.10:7447", "quic/base:7447", "ws/127.0.0.1:80"),
    "tcp/127.0.0.1:7447#so_sndbuf=32768",
)
OPEN = (
    *("tcp/0.0.0.0:7447", "tcp/192.168.1.10:7447", "tcp/base:7447", "udp/10.0.0.1:7447"),
    *("ws/base.example:80", "tcp/[::]:7447", "tcp/[fe80::1]:7447", "tcp/localhost.evil:7447"),
    "tcp/0.0.0.0:7447#127.0.0.1:1",
)


@pytest.mark.parametrize("endpoint", CLOSED)
def test_what_no_other_machine_can_use_is_accepted(endpoint: str) -> None:
    assert not is_open(endpoint)
    assert check_closed(endpoint, allow_open=False) == endpoint


@pytest.mark.parametrize("endpoint", OPEN)
def test_what_every_machine_can_use_has_to_be_accepted(endpoint: str) -> None:
    assert is_open(endpoint)
    assert check_closed(endpoint, allow_open=True) == endpoint
    with pytest.raises(InvalidInputError, match=r"fleet init INVENTORY.*--open"):
        check_closed(endpoint, allow_open=False)


@pytest.mark.parametrize(
    ("endpoint", "open_to_all"),
    [
        ("tls/0.0.0.0:7447", True),
        ("quic/base:7447#listen_certificate=a.pem;enable_mtls=false", True),
        ("tls/base:7447#listen_certificate=a.pem;enable_mtls=true", False),
        ("tls/127.0.0.1:7447", False),
        ("unixsock-stream//tmp/r.sock", False),
    ],
)
def test_a_router_that_asks_for_no_certificates_is_open(endpoint: str, open_to_all: bool) -> None:
    assert is_open(endpoint, anonymous=True) == open_to_all
    assert not is_open(endpoint)  # to those who connect, it proves itself


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only identity in the user's folder."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    path = tmp_path / "nufleet" / "desk.nufleet"
    path.parent.mkdir()
    path.touch()
    return path


def test_an_address_comes_from_the_most_explicit_place(mine: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.nufleet"
    endpoint = "tcp/127.0.0.1:7448"
    assert chosen_address(None, None, allow_open=False) == f"identity/{mine}"
    assert chosen_address(endpoint, None, allow_open=False) == endpoint
    assert chosen_address(endpoint, other, allow_open=False) == f"identity/{other}"
    mine.with_name("anna.nufleet").touch()
    with pytest.raises(IdentityError, match=r"which identity\? .*anna.*desk.*--identity"):
        chosen_address(None, None, allow_open=False)
    assert len(chosen_addresses(None, None, allow_open=False)) == 2
    mine.with_name("anna.nufleet").unlink()
    mine.unlink()
    assert chosen_address(None, None, allow_open=False) == LOCAL_ENDPOINT


def test_a_command_does_not_speak_as_a_robot_unless_it_knows_nothing_else(
    mine: Path,
) -> None:
    pem = "-----BEGIN CERTIFICATE-----\nMA==\n-----END CERTIFICATE-----\n"
    for name, role in (("desk", "orchestrator"), ("drone-7", "robot")):
        path = mine.with_name(f"{name}.nufleet")
        made = Identity(path, "lab", name, role, "tls/base:7447", pem, pem)
        path.write_text(identity_text(made))
        made.key.touch(mode=0o600)
    drone = mine.with_name("drone-7.nufleet")
    assert chosen_addresses(None, None, allow_open=False) == (f"identity/{mine}",)
    mine.unlink()
    assert chosen_addresses(None, None, allow_open=False) == (f"identity/{drone}",)
