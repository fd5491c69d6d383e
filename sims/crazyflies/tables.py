"""The tables of contents of the simulated firmware: what it logs, and its parameters."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

FLOAT, UINT8, UINT16, UINT32 = "float", "uint8", "uint16", "uint32"

LOGGED = {
    **{f"stateEstimate.{name}": FLOAT for name in ("x", "y", "z", "vx", "vy", "vz")},
    "stateEstimateZ.quat": UINT32,
    "pm.vbat": FLOAT,
    "supervisor.info": UINT16,
    **{f"kalman.var{name}": FLOAT for name in ("PX", "PY", "PZ")},
}
"""Variables that can be logged, with their types."""

PARAMETERS = {
    "stabilizer.estimator": UINT8,
    "stabilizer.controller": UINT8,
    "commander.enHighLevel": UINT8,
    **{f"kalman.initial{name}": FLOAT for name in ("X", "Y", "Z", "Yaw")},
    "kalman.resetEstimation": UINT8,
    "posCtlPid.xKp": FLOAT,
}
"""Parameters, with their types."""

LOG_CODES = {UINT8: 1, UINT16: 2, UINT32: 3, FLOAT: 7}
PARAMETER_CODES = {UINT8: 8, FLOAT: 6}
"""The protocol's numbers of types, which differ between the two tables."""

LOG_FORMATS = {1: "<B", 2: "<H", 3: "<L", 4: "<b", 5: "<h", 6: "<i", 7: "<f", 8: "<e"}
"""How a value of a type is packed in a log block."""

PARAMETER_FORMATS = {UINT8: "<B", FLOAT: "<f"}

ITEM, INFO = 2, 3
"""Commands of the table's channel, in their second version."""


@dataclass(frozen=True)
class Table:
    """One table of contents."""

    kinds: Mapping[str, str]
    """Types of the entries by name, in the order of their numbers."""
    codes: Mapping[str, int]
    """Numbers of the types."""

    @property
    def names(self) -> list[str]:
        """Names of the entries, in the order of their numbers."""
        return list(self.kinds)

    def answer(self, request: bytes) -> bytes | None:
        """Return the answer to a request on the table's channel; None for one that is wrong."""
        if request[0] == INFO:
            digest = zlib.crc32(repr(sorted(self.kinds.items())).encode())
            return bytes([INFO]) + struct.pack("<HI", len(self.kinds), digest)
        if request[0] == ITEM and len(request) >= 3:
            (place,) = struct.unpack_from("<H", request, 1)
            if place < len(self.kinds):
                name = self.names[place]
                text = b"\0".join(part.encode() for part in name.split(".")) + b"\0"
                return request[:3] + bytes([self.codes[self.kinds[name]]]) + text
        return None
