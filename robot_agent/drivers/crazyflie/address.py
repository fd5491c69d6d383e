"""Where a Crazyflie is reached: the URIs of cflib, checked before anything is opened."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

CHANNEL_MAX = 125
"""Highest channel of a Crazyradio."""

DEFAULT_ADDRESS = "E7E7E7E7E7"
"""Address of a Crazyflie as it is delivered."""

EXPECTED = (
    "radio://0/80/2M/E7E7E7E7E7 (dongle, channel, data rate, address), usb://0, udp://HOST:PORT or "
    "tcp://HOST:PORT"
)


def problem_of(uri: str) -> str | None:
    """Return what is wrong with a URI; None if a Crazyflie may be reached there.

    Examples:
        >>> problem_of("radio://0/80/2M/E7E7E7E7E7")
        >>> problem_of("radio://0/180/2M")
        'channel 180 is above 125, the highest of a Crazyradio'
    """
    scheme, _, rest = uri.partition("://")
    if scheme == "radio":
        return _radio_problem(rest)
    if scheme == "usb":
        return None if re.fullmatch(r"\d+", rest) else f"must be like usb://0, not {uri}"
    if scheme in ("udp", "tcp"):
        try:
            parts = urlsplit(uri)
            found = bool(parts.hostname and parts.port) and not parts.path.strip("/")
        except ValueError:
            found = False
        return None if found else f"must be like {scheme}://192.168.43.42:5000, not {uri}"
    return f"must be like {EXPECTED}, not {uri}"


def dongle_of(uri: str) -> str | None:
    """Return the name of the Crazyradio that a URI goes through; None if through none.

    Examples:
        >>> dongle_of("radio://0/80/2M/E7E7E7E701")
        'Crazyradio 0'
    """
    scheme, _, rest = uri.partition("://")
    return f"Crazyradio {rest.partition('/')[0].upper()}" if scheme == "radio" else None


def identity_of(uri: str) -> str:
    """Return the address itself: equal for two URIs that reach the same Crazyflie.

    Examples:
        >>> identity_of("radio://0/80/2M") == identity_of("radio://1/80/2M/e7e7e7e7e7?rate_limit=100")
        True
    """
    scheme, _, rest = uri.partition("?")[0].partition("://")
    if scheme != "radio":
        return uri.lower().rstrip("/")
    _, channel, rate, address = _radio_parts(rest)
    return f"radio channel {int(channel)}, {rate}, address {address.upper():0>10}"


def _radio_parts(rest: str) -> tuple[str, str, str, str]:
    given = rest.partition("?")[0].strip("/").split("/")
    defaults = ("", "2", "2M", DEFAULT_ADDRESS)
    dongle, channel, rate, address = (*given, *defaults[len(given) :])
    return dongle, channel, rate, address


def _radio_problem(rest: str) -> str | None:
    if rest.partition("?")[0].strip("/").count("/") > 3:
        return f"radio://{rest} has more than four parts: it must be like {EXPECTED}"
    dongle, channel, rate, address = _radio_parts(rest)
    if not re.fullmatch(r"\d{1,9}|[0-9A-Fa-f]{10,32}", dongle):
        return f"{dongle!r} is no dongle: give its number, such as 0, or its serial number"
    if not channel.isdecimal():
        return f"{channel!r} is no channel of a Crazyradio, 0 to {CHANNEL_MAX}"
    if int(channel) > CHANNEL_MAX:
        return f"channel {channel} is above {CHANNEL_MAX}, the highest of a Crazyradio"
    if rate not in ("250K", "1M", "2M"):
        return f"{rate!r} is no data rate: 250K, 1M or 2M"
    if not re.fullmatch(r"[0-9A-Fa-f]{1,10}", address):
        return f"{address!r} is no address: up to ten hexadecimal digits"
    query = rest.partition("?")[2]
    if query and not re.fullmatch(r"rate_limit=\d+", query):
        return f"{query!r} is no option of a radio: only rate_limit=PACKETS_PER_SECOND"
    return None
