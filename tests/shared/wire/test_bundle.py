"""States of many robots in one message."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.bundle import bundled, unbundled

NAMES = st.from_regex(r"\A[a-z0-9][a-z0-9_-]{0,62}\Z")


@given(st.dictionaries(NAMES, st.binary(max_size=200)), st.integers(0, 500))
def test_every_robot_comes_back_once_with_its_frame_whatever_fits_into_a_message(
    frames: dict[str, bytes], most_bytes: int
) -> None:
    messages = list(bundled(frames, most_bytes=most_bytes))
    assert [pair for one in messages for pair in unbundled(one)] == list(frames.items())
    for message in messages:
        assert len(message) <= most_bytes or len(list(unbundled(message))) == 1


def test_as_few_messages_are_sent_as_the_frames_need() -> None:
    frames = {f"r{k}": bytes(90) for k in range(20)}
    assert len(list(bundled(frames, most_bytes=1000))) == 2
    assert list(bundled({}, most_bytes=1000)) == []


@given(st.binary(max_size=60))
def test_no_bytes_break_the_receiver(message: bytes) -> None:
    with suppress(MalformedMessageError):
        assert all(robot and isinstance(frame, bytes) for robot, frame in unbundled(message))


@pytest.mark.parametrize(
    "broken",
    [
        lambda whole: whole[:3],
        lambda whole: whole[:-1],
        lambda whole: whole + b"\0",
        lambda whole: whole.replace(b"drone", b"DRONE"),
        lambda whole: whole.replace(b"drone", b"\xff\xff\xff\xff\xff"),
    ],
)
def test_a_message_that_is_cut_or_names_no_robot_is_refused(broken: object) -> None:
    (whole,) = bundled({"drone": b"state"}, most_bytes=1000)
    assert callable(broken)
    with pytest.raises(MalformedMessageError):
        list(unbundled(broken(whole)))
