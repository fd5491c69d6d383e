"""Removal of secrets from addresses before they are shown, logged or stored."""

from __future__ import annotations

import re

HIDDEN = "***"

# Each pattern hides rather too much than too little. A URL parser is no alternative: urllib's ends
# the password at a slash, and the text may be a sentence that contains an address.
_PASSWORD = re.compile(r"(://[^:@\s]*:).*@", re.DOTALL)
_PASSWORD_IN_QUERY = re.compile(r"([?&]\w*password=)[^&\s]*")
_ENDPOINT = re.compile(r"(\b[a-z][a-z-]*/[^\s#]*)#\S*")


def without_secrets(text: str) -> str:
    """Return a text with the secrets hidden in all addresses that it contains.

    In the URL of a database the password is hidden. In a Zenoh endpoint everything after the
    address is hidden (`tls/HOST:PORT#...`), since it may contain private keys.

    Args:
        text: Address, or any text that may contain addresses.
    """
    text = _PASSWORD.sub(rf"\1{HIDDEN}@", text)
    text = _PASSWORD_IN_QUERY.sub(rf"\1{HIDDEN}", text)
    return _ENDPOINT.sub(rf"\1#{HIDDEN}", text)
