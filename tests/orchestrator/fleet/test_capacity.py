"""How many robots fit on a machine, and what is said about those that do not."""

from __future__ import annotations

import pytest

from nufleet.orchestrator.fleet.capacity import Machine, check_room
from nufleet.shared.errors import InvalidInputError

LAPTOP = Machine(cores=2, memory_bytes=8 * 10**9, open_files=2**19)
BOARD = Machine(cores=4, memory_bytes=3 * 10**8, open_files=4096)
STRICT = Machine(cores=2, memory_bytes=8 * 10**9, open_files=1024)


@pytest.mark.parametrize(
    ("machine", "processes", "room"),
    [
        *((LAPTOP, 4, 1000), (LAPTOP, None, 100), (BOARD, 2, 108), (BOARD, None, 3), (BOARD, 9, 0)),
        *((STRICT, 2, 462), (STRICT, None, 100)),
    ],
)
def test_cores_memory_and_open_files_limit_the_number_of_robots(
    machine: Machine, processes: int | None, room: int
) -> None:
    check_room(room, processes=processes, machine=machine)
    with pytest.raises(InvalidInputError, match=f"{room + 1} robots are.*room for about {room}"):
        check_room(room + 1, processes=processes, machine=machine)


def test_this_machine_has_room_for_the_demo() -> None:
    check_room(4, processes=2, machine=Machine.this())
