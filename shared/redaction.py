"""Addresses as they may be shown, logged and stored: without the secrets that are in some."""

from __future__ import annotations

import re

HIDDEN = "***"

# Each hides rather too much than too little. A parser of URLs would not do: urllib's ends the
# password at a slash, and what is shown may be a sentence with an address in it.
_PASSWORD = re.compile(r"(://[^:@\s]*:).*@", re.DOTALL)
_PASSWORD_IN_QUERY = re.compile(r"([?&]\w*password=)[^&\s]*")
_ENDPOINT = re.compile(r"(\b[a-z][a-z-]*/[^\s#]*)#\S*")


def without_secrets(text: str) -> str:
    """Return a text with the addresses in it as they may be shown.

    Of a database's URL the password is hidden; of a Zenoh endpoint all that comes after its address
    (`tls/HOST:PORT#...`), where private keys may stand.
    """
    text = _PASSWORD.sub(rf"\1{HIDDEN}@", text)
    text = _PASSWORD_IN_QUERY.sub(rf"\1{HIDDEN}", text)
    return _ENDPOINT.sub(rf"\1#{HIDDEN}", text)
