"""What comes from outside: nothing is coerced, nothing unknown is let in, any text can be said."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from nufleet.shared.strict import Identifier, Name, Reason, Strict, describe_validation
from nufleet.shared.text import as_reason


class Sample(Strict):
    count: int
    share: float = 0.5


NAME_WORDS = (
    "name: must consist of lower-case letters, digits, - and _, and begin with a letter or digit"
)
REASON: TypeAdapter[str] = TypeAdapter(Reason)


@given(text=st.text(max_size=50) | st.text(st.characters(categories=["Cs"])) | st.just("ä" * 5000))
def test_any_text_can_be_given_as_a_reason(text: str) -> None:
    reason = REASON.validate_python(text)
    assert reason == as_reason(text)
    assert REASON.validate_python(reason) == reason
    if len(text) <= 2000 and text.isascii() and text.isprintable():
        assert reason == text
    assert len(reason) == min(len(text), 2000)
    # It can be sent, and no terminal does anything but show it.
    assert reason.encode().decode() == reason
    assert not any(c in reason for c in "\x1b\n\r\x9b\u2028\u202e")


@pytest.mark.parametrize("wrong", [None, 3, ["smoke"]])
def test_what_is_no_text_is_no_reason(wrong: object) -> None:
    with pytest.raises(ValidationError):
        REASON.validate_python(wrong)


def test_an_error_can_be_given_as_a_reason() -> None:
    assert as_reason(OSError("the line is gone")) == "the line is gone"


@pytest.mark.parametrize(
    "wrong",
    [
        '{"count": "1"}',
        '{"count": 1.5}',
        '{"count": true}',
        '{"count": null}',
        '{"count": 1, "share": NaN}',
        '{"count": 1, "share": Infinity}',
        '{"count": 1, "share": "0.5"}',
        '{"count": 1, "more": 1}',
        "{}",
        "[]",
    ],
)
def test_what_is_not_exactly_right_is_refused(wrong: str) -> None:
    with pytest.raises(ValidationError):
        Sample.model_validate_json(wrong)


def test_a_value_cannot_be_changed() -> None:
    sample = Sample(count=1)
    with pytest.raises(ValidationError):
        sample.count = 2  # type: ignore[misc]


@pytest.mark.parametrize("kind", [Name, Identifier])
def test_a_trailing_newline_is_not_overlooked(kind: type[str]) -> None:
    adapter: TypeAdapter[str] = TypeAdapter(kind)
    assert adapter.validate_python("a") == "a"
    with pytest.raises(ValidationError):
        adapter.validate_python("a\n")


class Fleet(Strict):
    name: Name
    beta: float
    speed: float = 1.0


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ('{"name": "lab", "betta": 1.0}', "beta: missing; betta: unknown; did you mean beta?"),
        ('{"name": "lab", "beta": 1.0, "x": 1}', "x: unknown"),
        ('{"name": "lab", "beta": "a"}', "beta: must be a valid number"),
        (
            '{"name": "My Lab", "beta": 1.0}',
            NAME_WORDS,
        ),
    ],
)
def test_what_is_wrong_is_said_without_the_words_of_the_library(wrong: str, words: str) -> None:
    with pytest.raises(ValidationError) as refused:
        Fleet.model_validate_json(wrong)
    assert describe_validation(refused.value) == words
