"""The journal's bytes: cut anywhere, altered anywhere, nothing is invented or lost unnoticed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.robot_agent.journal.frames import (
    FILE_HEAD_BYTES,
    MAX_PAYLOAD_BYTES,
    encode_frame,
    file_head,
    scan,
)

SALT = bytes(range(16))
PAYLOADS = st.lists(st.binary(max_size=40), max_size=5)


def journal(payloads: list[bytes], salt: bytes = SALT) -> bytes:
    frames = (encode_frame(salt, n, payload) for n, payload in enumerate(payloads, start=1))
    return file_head(salt) + b"".join(frames)


@given(payloads=PAYLOADS)
def test_what_was_written_is_read(payloads: list[bytes]) -> None:
    data = journal(payloads)
    found = scan(data)
    assert found.payloads == tuple(payloads)
    assert (found.salt, found.last_number) == (SALT, len(payloads))
    assert (found.sound_bytes, found.torn_bytes, found.damage) == (len(data), 0, None)


@given(payloads=PAYLOADS)
def test_cut_at_any_byte_it_holds_exactly_the_records_that_were_whole(
    payloads: list[bytes],
) -> None:
    data = journal(payloads)
    for end in range(FILE_HEAD_BYTES, len(data)):
        whole = max(n for n in range(len(payloads) + 1) if len(journal(payloads[:n])) <= end)
        found = scan(data[:end])
        assert found.payloads == tuple(payloads[:whole])
        assert found.damage is None
        assert found.sound_bytes + found.torn_bytes == end
        assert found.sound_bytes == len(journal(payloads[:whole]))


@given(payloads=PAYLOADS, zeros=st.integers(1, 5000))
def test_zeros_that_a_file_system_leaves_are_no_records(payloads: list[bytes], zeros: int) -> None:
    found = scan(journal(payloads) + bytes(zeros))
    assert (found.payloads, found.torn_bytes, found.damage) == (tuple(payloads), zeros, None)


def test_a_beginning_that_is_cut_off_is_damage() -> None:
    # It is put in its place whole, so no crash leaves half of it.
    for end in range(FILE_HEAD_BYTES):
        found = scan(journal([b"one"])[:end])
        assert found.payloads == ()
        assert found.damage


@given(payloads=PAYLOADS, bit=st.integers(0, 7))
def test_any_altered_byte_is_damage_and_costs_one_record_at_most(
    payloads: list[bytes], bit: int
) -> None:
    data = journal(payloads)
    for place in range(len(data)):
        altered = bytearray(data)
        altered[place] ^= 1 << bit
        found = scan(bytes(altered))
        assert found.damage
        if place < FILE_HEAD_BYTES:
            assert found.payloads == ()
            continue
        hit = next(n for n in range(len(payloads)) if place < len(journal(payloads[: n + 1])))
        assert found.payloads == (*payloads[:hit], *payloads[hit + 1 :])
        assert found.sound_bytes == len(journal(payloads[:hit]))


def test_a_record_that_was_taken_out_or_put_twice_is_noticed() -> None:
    one, two, three = (encode_frame(SALT, n, b"x%d" % n) for n in (1, 2, 3))
    missing = scan(file_head(SALT) + one + three)
    assert missing.damage
    assert missing.payloads == (b"x1", b"x3")
    twice = scan(file_head(SALT) + one + two + two + three)
    assert twice.damage
    assert twice.payloads == (b"x1", b"x2", b"x3")


@given(payload=st.binary(max_size=20))
def test_a_record_inside_a_record_is_not_believed(payload: bytes) -> None:
    # A reason may contain the bytes of another journal's record.
    forged = encode_frame(bytes(16), 2, b"forged")
    data = bytearray(journal([forged + payload, b"next"]))
    assert scan(bytes(data)).payloads == (forged + payload, b"next")
    data[FILE_HEAD_BYTES] ^= 1
    assert scan(bytes(data)).payloads == (b"next",)


@given(rest=st.binary(max_size=200))
def test_any_bytes_at_all_give_an_answer(rest: bytes) -> None:
    assert scan(rest).payloads == ()
    assert scan(file_head(SALT) + rest).payloads == ()


def test_a_record_that_would_not_be_read_again_is_not_written() -> None:
    longest = bytes(MAX_PAYLOAD_BYTES)
    assert scan(journal([longest])).payloads == (longest,)
    with pytest.raises(ValueError, match="at most"):
        encode_frame(SALT, 1, longest + b"x")
