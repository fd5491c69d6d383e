"""Limits of the links of a fleet, which its routers, robots and orchestrators share."""

from __future__ import annotations

LEASE_MS = 2000
"""Time after which a silent session is considered lost, and thus the delay in noticing a partition.
"""

FULL_LINK_WAIT_US = 250_000
"""Time that a router waits for a blocked link before closing it.

Meanwhile all other messages of the same sender wait too, including a stop of other robots. Zenoh's
default of 5 s lets 4 MB through a link of 20 Mbit/s; this value lets 1 MB through a link of
10 Mbit/s (measured).
"""

MAX_MESSAGE_BYTES = 16 * 2**20
"""Largest message of any kind that a session accepts: a computer with 1 GB of memory must survive a
sender of larger ones."""

MAX_STATE_BYTES = 64 * 1024
"""Largest state that a subscriber accepts; real ones take a few kilobytes at most."""

MAX_STATES_BYTES = 256 * 1024
"""Largest message with the states of several robots, some hundreds of them."""
