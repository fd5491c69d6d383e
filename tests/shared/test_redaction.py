"""What is shown of addresses: enough to know them again, and nothing that is secret."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.shared.redaction import without_secrets

SECRETS = ("cret", "MIIEv", "hunter2")


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("postgresql://u:cret@h/d", "postgresql://u:***@h/d"),
        ("postgresql://u:se/cret@h/d", "postgresql://u:***@h/d"),
        ("postgresql://u:s@e:c?#cret@h/d", "postgresql://u:***@h/d"),
        ("postgresql://:cret@h/d", "postgresql://:***@h/d"),
        ("--repository=postgresql://u:se cret@h/d", "--repository=postgresql://u:***@h/d"),
        (
            "postgresql://h/d?sslmode=require&password=cret&sslpassword=hunter2",
            "postgresql://h/d?sslmode=require&password=***&sslpassword=***",
        ),
        ("tls/h:7447#connect_private_key_base64=MIIEv/+=;enable_mtls=true", "tls/h:7447#***"),
        ("--connect=quic/h:7447#k=MIIEv", "--connect=quic/h:7447#***"),
        (
            "no router answers at tls/h:1#k=MIIEv; start one",
            "no router answers at tls/h:1#*** start one",
        ),
    ],
)
def test_the_secret_of_an_address_is_hidden_and_its_place_is_not(address: str, shown: str) -> None:
    assert without_secrets(address) == shown
    assert not any(secret in without_secrets(address) for secret in SECRETS)


@pytest.mark.parametrize(
    "address",
    [
        "postgresql://u@h:5432/d",
        "postgresql://u@/d?host=/run/postgresql",
        "sqlite:///runs/nufleet.sqlite",
        "runs/nufleet.sqlite",
        "tcp/127.0.0.1:7447",
        "unixsock-stream//tmp/router.sock",
        "--band",
    ],
)
def test_an_address_without_a_secret_is_shown_as_it_is(address: str) -> None:
    assert without_secrets(address) == address


@given(password=st.text(st.characters(blacklist_categories=["Cs"]), min_size=1))
def test_whatever_a_password_is_made_of_nothing_of_it_is_shown(password: str) -> None:
    assert without_secrets(f"postgresql://u:{password}@h/d") == "postgresql://u:***@h/d"
