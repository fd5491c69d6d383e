"""Where a vehicle is reached: `udpin://0.0.0.0:14540` and the like, as MAVSDK writes them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

_ADDRESS = re.compile(r"(udpin|udpout|tcpout)://([^:/\s]+|\[[0-9a-fA-F:]+\]):([0-9]{1,5})")
_SERIAL = re.compile(r"serial://(/[^\s:]+|COM[0-9]+):([0-9]+)")

FORMS = (
    "`udpin://0.0.0.0:14540` (waits for it), `udpout://HOST:14550`, `tcpout://HOST:5760` or "
    "`serial:///dev/ttyACM0:57600`"
)


@dataclass(frozen=True)
class Address:
    """One address, taken apart."""

    way: Literal["udpin", "udpout", "tcpout", "serial"]
    """How packets travel."""
    place: str
    """Host, or path of the serial port."""
    number: int
    """Port, or baud rate."""

    @classmethod
    def parsed(cls, url: str) -> Address:
        """Take a URL apart.

        Raises:
            ValueError: It is none; the message shows the forms there are.

        Examples:
            >>> Address.parsed("udpout://10.0.0.7:14550").number
            14550
        """
        net, serial = _ADDRESS.fullmatch(url), _SERIAL.fullmatch(url)
        if serial:
            return cls("serial", serial[1], int(serial[2]))
        if not net or not 0 < int(net[3]) <= 65535:
            raise ValueError(f"{url!r} is no address of a vehicle such as {FORMS}")
        way = net[1]
        assert way in {"udpin", "udpout", "tcpout"}  # noqa: S101 - as the pattern says
        return cls(way, net[2].strip("[]"), int(net[3]))  # type: ignore[arg-type]
