"""How many robots fit on a machine, and what is said about those that do not."""

from __future__ import annotations

import pytest

from nufleet.orchestrator.fleet.capacity import Machine, check_room
from nufleet.shared.errors import InvalidInputError

LAPTOP = Machine(cores=2, memory_bytes=8 * 10**9)
BOARD = Machine(cores=4, memory_bytes=3 * 10**8)


@pytest.mark.parametrize(
    ("machine", "processes", "room"),
    [(LAPTOP, 4, 1000), (LAPTOP, None, 100), (BOARD, 2, 108), (BOARD, None, 3), (BOARD, 9, 0)],
)
def test_cores_and_memory_limit_the_number_of_robots(
    machine: Machine, processes: int | None, room: int
) -> None:
    check_room(room, processes=processes, machine=machine)
    with pytest.raises(InvalidInputError, match=f"{room + 1} robots are.*room for about {room}"):
        check_room(room + 1, processes=processes, machine=machine)


def test_this_machine_has_room_for_the_demo() -> None:
    check_room(4, processes=2, machine=Machine.this())
