"""Frames: every message comes back as it was sent, and no bytes can do more than be refused."""

from __future__ import annotations

import json
import struct
import sys
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import BaseModel, ValidationError

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import (
    DamagedMessageError,
    MalformedMessageError,
    ProtocolVersionError,
)
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire import codec, messages
from nufleet.shared.wire.codec import MAX_BODY_BYTES, Float64Array, Message, decode, encode
from nufleet.shared.wire.frame import (
    CHECKSUM,
    PROTOCOL_VERSION,
    framed,
    sealed,
    stop_frame,
)
from nufleet.shared.wire.messages import (
    AcknowledgeRequest,
    CancelRequest,
    DescribeRequest,
    Description,
    Done,
    ExperienceFile,
    ExperienceOffer,
    FetchRequest,
    ForecastRequest,
    Foreseen,
    ForeseenWay,
    GoalAccepted,
    GoalRequest,
    GoalResult,
    InstallRequest,
    Outcome,
    PathForecast,
    Refusal,
    ReleaseRequest,
    RemovePriorRequest,
    ResultRequest,
    RobotState,
    RobotStatus,
    StopRequest,
    Telemetry,
    TrackingTelemetry,
)
from nufleet.shared.wire.motions import PredictedError, RichFlight, StepTest, Tracking, Weighted

EVERY_TYPE = tuple(
    kind
    for kind in vars(messages).values()
    if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
)

names = st.from_regex(r"[a-z0-9][a-z0-9_-]{0,62}", fullmatch=True)
identifiers = st.from_regex(r"[0-9a-z][0-9a-z._-]{0,199}", fullmatch=True)
epochs = st.integers(0, 2**63 - 1)
sentences = st.text(st.characters(exclude_categories=["Cs"]), max_size=200)
positive = st.floats(1e-6, 1e6)
non_negative = st.floats(0, 1e6)
finite = st.floats(allow_nan=False, allow_infinity=False)

tones = st.lists(
    st.builds(Tone, omega_rad_s=positive, weight=positive, phase_rad=finite),
    min_size=1,
    max_size=4,
    unique_by=lambda tone: tone.omega_rad_s,
).map(tuple)
excitations = st.builds(
    Excitation,
    axis=names,
    tones=tones,
    amplitude=st.none() | positive,
    segments=st.integers(3, 64),
    segment_min_s=non_negative,
    settle_s=st.none() | non_negative,
)
plans = st.builds(
    ExcitationPlan,
    axis=names,
    tones=tones,
    amplitude=positive,
    sample_time_s=positive,
    ramp_samples=st.integers(1, 50),
    settle_samples=st.integers(0, 50),
    segments=st.integers(3, 5),
    segment_samples=st.integers(4, 20),
)


def finite_array(samples: int | tuple[int, ...]) -> st.SearchStrategy[FloatArray]:
    return arrays(np.float64, samples, elements=finite)


@st.composite
def results(draw: st.DrawFn) -> GoalResult:
    plan = draw(plans)
    outcome = draw(st.sampled_from(Outcome))
    whole = outcome is Outcome.COMPLETED
    samples = plan.samples if whole else draw(st.integers(0, plan.samples))
    return GoalResult(
        goal_id=draw(identifiers),
        boot_id=draw(identifiers),
        outcome=outcome,
        reason=draw(sentences),
        plan=plan,
        reference=draw(finite_array(samples)),
        response=draw(finite_array(samples)),
    )


@st.composite
def linear_models(draw: st.DrawFn) -> LinearModel:
    order = draw(st.integers(1, 4))
    row = st.lists(finite, min_size=order, max_size=order).map(tuple)
    return LinearModel(
        a=tuple(draw(row) for _ in range(order)),
        b=draw(row),
        c=draw(row),
        d=draw(finite),
        sample_time_s=draw(positive),
    )


@st.composite
def descriptions(draw: st.DrawFn) -> Description:
    axes = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    return Description(
        robot=draw(names),
        boot_id=draw(identifiers),
        spec=RobotSpec(
            kind=draw(names),
            axes=tuple(
                AxisSpec(
                    name=axis,
                    unit=draw(st.sampled_from(["m", "rad"])),
                    amplitude_max=draw(positive),
                    velocity_max=draw(positive),
                    acceleration_max=draw(positive),
                    model=draw(st.none() | linear_models()),
                )
                for axis in axes
            ),
            sample_time_s=draw(st.floats(1e-4, 1e-2)),
            omega_min_rad_s=draw(st.floats(1e-6, 1.0)),
            omega_max_rad_s=draw(st.floats(1.5, 300.0)),
            duration_max_s=draw(positive),
            settling_time_s=draw(non_negative),
            simulated=draw(st.booleans()),
        ),
        owner=draw(st.none() | identifiers),
        epoch=draw(epochs),
    )


@st.composite
def telemetry(draw: st.DrawFn) -> Telemetry:
    samples = draw(st.integers(0, 40))
    return Telemetry(
        goal_id=draw(identifiers),
        first_sample=draw(st.integers(0, 2**40)),
        sample_time_s=draw(non_negative),
        reference=draw(finite_array(samples)),
        response=draw(finite_array(samples)),
    )


goal_ids = st.lists(identifiers, max_size=5).map(tuple)
digests = st.text("0123456789abcdef", min_size=64, max_size=64)
flights = st.tuples(st.integers(2, 20), st.integers(1, 3)).flatmap(finite_array)
motions = (
    excitations
    | st.builds(StepTest, axis=names)
    | st.builds(RichFlight, duration_s=st.floats(1, 3600), seed=st.integers(0, 2**40))
    | st.builds(Tracking, desired=flights, inverse=st.just("baseline"), guarded=st.booleans())
    | st.builds(Tracking, desired=flights, inverse=st.just("prior"), prior_sha256=digests)
    | st.builds(
        Tracking,
        desired=flights,
        inverse=st.just("mixture"),
        mixture=st.builds(
            lambda digest, weight: (Weighted(sha256=digest, weight=weight),),
            digests,
            st.floats(0.01, 0.99),
        ),
    )
)
expected_errors = st.tuples(non_negative, non_negative, non_negative).map(
    lambda three: PredictedError(rms=three[0], low=three[1], high=three[2])
)
foreseen = (
    st.none()
    | st.builds(Foreseen, predicted=expected_errors)
    | st.builds(Foreseen, code=names, reason=sentences)
)
ways = (
    st.builds(ForeseenWay, inverse=st.just("baseline"), guarded=st.booleans())
    | st.builds(ForeseenWay, inverse=st.just("prior"), prior_sha256=digests, learn=st.booleans())
    | st.builds(ForeseenWay, inverse=st.just("own"), after_rich_flight_s=st.floats(0, 3600))
)
LAYOUT = InverseLayout(
    architecture="state", states=("position",), sample_time_s=0.02, horizon_samples=5
)
MANIFEST = ExperienceManifest(
    robot="r",
    robot_kind="k",
    axes=("x",),
    unit="m",
    layout=LAYOUT,
    inputs=LAYOUT.input_names,
    relative_degree=1,
    input_mean=(0.0, 0.0),
    input_scale=(1.0, 1.0),
    output_mean=0.0,
    output_scale=1.0,
    points=500,
    validation_rms=0.1,
    data_sha256="0" * 64,
    seed=0,
    training_version="1",
)
STRATEGIES: dict[type[Message], st.SearchStrategy[Message]] = {
    Refusal: st.builds(Refusal, code=names, reason=sentences),
    DescribeRequest: st.builds(DescribeRequest),
    Description: descriptions(),
    GoalRequest: st.builds(
        GoalRequest,
        goal_id=identifiers,
        owner=identifiers,
        epoch=epochs,
        motion=motions,
        acknowledges=goal_ids,
    ),
    GoalAccepted: st.builds(
        GoalAccepted,
        goal_id=identifiers,
        boot_id=identifiers,
        plan=plans,
        wall_duration_s=non_negative,
    ),
    CancelRequest: st.builds(CancelRequest, sender=identifiers, epoch=epochs, goal_id=identifiers),
    ResultRequest: st.builds(ResultRequest, goal_id=identifiers),
    AcknowledgeRequest: st.builds(
        AcknowledgeRequest, sender=identifiers, epoch=epochs, goal_ids=goal_ids
    ),
    GoalResult: results(),
    StopRequest: st.builds(StopRequest, sender=identifiers, reason=sentences, order_id=identifiers),
    ReleaseRequest: st.builds(ReleaseRequest, sender=identifiers),
    Done: st.builds(Done),
    RobotState: st.builds(
        RobotState,
        robot=names,
        boot_id=identifiers,
        sequence=st.integers(0, 2**60),
        status=st.sampled_from(RobotStatus),
        goal_id=st.none() | identifiers,
        progress=st.floats(0, 1),
        reason=sentences,
        last_goal_id=st.none() | identifiers,
        robot_time_s=non_negative,
    ),
    Telemetry: telemetry(),
    TrackingTelemetry: flights.map(
        lambda array: TrackingTelemetry(
            goal_id="g",
            first_sample=0,
            sample_time_s=0.02,
            desired=array,
            actual=array,
            prior=array,
            mean=array,
            variance=array,
            share=array[:, 0],
            experts=("source-1",) if array.shape[1] == 2 else (),
            weights=array if array.shape[1] == 2 else None,
        )
    ),
    FetchRequest: st.builds(FetchRequest, sha256=digests),
    ExperienceFile: st.builds(ExperienceFile, sha256=digests, payload=st.binary()),
    ExperienceOffer: digests.map(
        lambda sha256: ExperienceOffer(sha256=sha256, size_bytes=3, manifest=MANIFEST)
    ),
    InstallRequest: st.builds(
        InstallRequest, sender=identifiers, epoch=epochs, sha256=digests, payload=st.binary()
    ),
    RemovePriorRequest: st.builds(
        RemovePriorRequest,
        sender=identifiers,
        epoch=epochs,
        what=st.sampled_from(["priors", "own-model"]),
    ),
    ForecastRequest: st.builds(
        ForecastRequest, desired=flights, ways=st.lists(ways, min_size=1, max_size=4).map(tuple)
    ),
    PathForecast: st.builds(PathForecast, foreseen=st.lists(foreseen, max_size=4).map(tuple)),
}

RESULT = GoalResult(
    goal_id="run-1.2.drone_3.1",
    boot_id="b00f",
    outcome=Outcome.FAILED,
    reason="a sensor",
    plan=ExcitationPlan(
        axis="x",
        tones=(Tone(omega_rad_s=1.0),),
        amplitude=0.5,
        sample_time_s=0.01,
        ramp_samples=10,
        settle_samples=0,
        segments=3,
        segment_samples=20,
    ),
    reference=np.linspace(-1.0, 1.0, 30),
    response=np.linspace(0.0, 3.0, 30),
)


def assert_same(one: BaseModel, other: BaseModel) -> None:
    assert type(one) is type(other)
    for field in type(one).model_fields:
        mine, theirs = getattr(one, field), getattr(other, field)
        if isinstance(mine, np.ndarray):
            assert mine.dtype == theirs.dtype
            np.testing.assert_array_equal(mine, theirs, strict=True)
        elif isinstance(mine, BaseModel):
            assert_same(mine, theirs)
        else:
            assert mine == theirs


def header(kind: str = "Done", protocol: object = PROTOCOL_VERSION, **more: object) -> bytes:
    return json.dumps({"protocol": protocol, "type": kind, **more}).encode()


def parts_of(payload: bytes) -> tuple[dict[str, object], dict[str, object], bytes]:
    head_bytes, body_bytes = struct.unpack_from("<II", payload, 4)
    head_end = 12 + head_bytes
    body_end = head_end + body_bytes
    return (
        json.loads(payload[12:head_end]),
        json.loads(payload[head_end:body_end]),
        payload[body_end : -CHECKSUM.size],
    )


def rebuilt(
    message: Message,
    *,
    head: Callable[[dict[str, object]], object] = lambda head: None,
    body: Callable[[dict[str, object]], object] = lambda body: None,
    raw: Callable[[bytes], bytes] = lambda raw: raw,
) -> bytes:
    """The frame of a message with its header, body or arrays changed."""
    head_json, body_json, arrays_raw = parts_of(encode(message))
    head(head_json)
    body(body_json)
    head_sent, body_sent = json.dumps(head_json).encode(), json.dumps(body_json).encode()
    return framed(head_sent, body_sent, [raw(arrays_raw)])


# What is sent comes back.


def test_there_is_a_strategy_for_every_message_type() -> None:
    assert set(STRATEGIES) == set(EVERY_TYPE)


@pytest.mark.parametrize("kind", EVERY_TYPE, ids=lambda kind: kind.__name__)
@settings(max_examples=12)
@given(data=st.data())
def test_every_message_comes_back_as_it_was_sent(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(STRATEGIES[kind])
    assert_same(message, decode(encode(message), kind))


def test_a_decoded_array_is_aligned_and_cannot_be_written() -> None:
    for extra in range(9):
        message = RESULT.model_copy(update={"reason": "x" * extra})
        decoded = decode(encode(message), GoalResult)
        for array in (decoded.reference, decoded.response):
            assert array.flags.aligned
            assert not array.flags.writeable


def test_an_array_of_any_layout_travels_by_its_values() -> None:
    class Matrix(Message):
        values: Float64Array

    base = np.arange(24.0).reshape(2, 3, 4)
    for values in (base, base.T, base[:, ::2], base[0], base[:0], np.asfortranarray(base)):
        back = decode(encode(Matrix(values=values)), Matrix)
        np.testing.assert_array_equal(back.values, values, strict=True)


def test_the_type_says_which_of_several_expected_messages_came() -> None:
    refusal = Refusal(code="busy", reason="later")
    assert decode(encode(refusal), Done, Refusal) == refusal
    assert decode(encode(Done()), Done, Refusal) == Done()


# What is not a message is refused.


@settings(max_examples=150, deadline=None)
@given(payload=st.binary(max_size=300), framed=st.booleans())
def test_no_bytes_raise_anything_but_malformed(payload: bytes, framed: bool) -> None:
    payload = b"NUF1" + payload if framed else payload
    for sent in (payload, sealed(payload)):
        with pytest.raises(MalformedMessageError):
            decode(sent, *EVERY_TYPE)


@settings(max_examples=150, deadline=None)
@given(head=st.binary(max_size=80), body=st.binary(max_size=80), raw=st.binary(max_size=40))
def test_no_framed_parts_raise_anything_but_malformed(head: bytes, body: bytes, raw: bytes) -> None:
    with pytest.raises(MalformedMessageError):
        decode(framed(head, body, [raw]), *EVERY_TYPE)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=10,
)


@settings(max_examples=100, deadline=None)
@given(
    kind=st.sampled_from(EVERY_TYPE),
    arrays_said=json_values,
    body=st.dictionaries(st.sampled_from(["reference", "goal_id", "plan", "x"]), json_values),
    raw=st.binary(max_size=64),
)
def test_no_json_raises_anything_but_malformed(
    kind: type[Message], arrays_said: object, body: dict[str, object], raw: bytes
) -> None:
    payload = framed(header(kind.__name__, arrays=arrays_said), json.dumps(body).encode(), [raw])
    try:
        message = decode(payload, *EVERY_TYPE)
    except MalformedMessageError:
        return
    assert not body
    assert isinstance(message, DescribeRequest | Done)  # the two without fields


@pytest.mark.parametrize("kind", [GoalResult, RobotState, GoalRequest, Description])
@settings(max_examples=15)
@given(data=st.data())
def test_a_truncated_or_longer_frame_is_refused(kind: type[Message], data: st.DataObject) -> None:
    payload = encode(data.draw(STRATEGIES[kind]))
    bare = payload[: -CHECKSUM.size]
    cut = data.draw(st.integers(0, len(bare) - 1))
    for sent in (payload[:cut], payload + b"\0", sealed(payload[:cut]), sealed(bare + b"\0")):
        with pytest.raises(MalformedMessageError):
            decode(sent, kind)


@settings(max_examples=150, deadline=None)
@given(place=st.integers(12, len(encode(RESULT)) - 1), change=st.integers(1, 255))
def test_what_was_altered_on_its_way_is_known_by_its_checksum(place: int, change: int) -> None:
    payload = bytearray(encode(RESULT))
    of_version = payload.index(b"%d" % PROTOCOL_VERSION)
    payload[place] ^= change
    known = (
        (DamagedMessageError, ProtocolVersionError) if place == of_version else DamagedMessageError
    )
    with pytest.raises(known):
        decode(bytes(payload), GoalResult)


@settings(max_examples=150, deadline=None)
@given(place=st.integers(0, len(encode(RESULT)) - 1 - CHECKSUM.size), value=st.integers(0, 255))
def test_another_byte_gives_a_valid_message_or_is_refused(place: int, value: int) -> None:
    payload = bytearray(encode(RESULT)[: -CHECKSUM.size])
    payload[place] = value
    try:
        message = decode(sealed(bytes(payload)), GoalResult)
    except MalformedMessageError:
        return
    # A message that still decodes satisfies the constraints of its type.
    GoalResult.model_validate(dict(message))


def test_every_altered_byte_of_the_prefix_and_the_lengths_is_refused() -> None:
    payload = encode(RESULT)[: -CHECKSUM.size]
    for place in range(12):
        for value in {0, 1, 127, 128, 255, payload[place] ^ 1} - {payload[place]}:
            altered = payload[:place] + bytes([value]) + payload[place + 1 :]
            with pytest.raises(MalformedMessageError):
                decode(sealed(altered), GoalResult)


LYING_SHAPES = [
    [10**30],
    [2**63],
    [-1],
    [29],
    [31],
    [],
    [30, 1, 1, 1],
    [0],
    [0, 10**30],
    [2**62, 4],
    [2**32, 2**32],
    [15.0, 2],
    ["30"],
    [None],
    [True, 30],
]


@pytest.mark.parametrize("shape", LYING_SHAPES, ids=str)
def test_a_header_that_lies_about_a_shape_is_refused(shape: list[object]) -> None:
    def lie(head: dict[str, object]) -> None:
        head["arrays"] = [{"dtype": "<f8", "shape": shape}, {"dtype": "<f8", "shape": [30]}]

    with pytest.raises(MalformedMessageError):
        decode(rebuilt(RESULT, head=lie), GoalResult)


@settings(max_examples=100, deadline=None)
@given(
    shape=st.lists(
        st.sampled_from([0, 1, 2**26, 2**31, 2**62, 2**64]) | st.integers(0, 2**70),
        min_size=1,
        max_size=3,
    )
)
def test_an_empty_array_of_huge_shape_is_refused_or_empty(shape: list[int]) -> None:
    class Matrix(Message):
        values: Float64Array

    head = header("Matrix", arrays=[{"dtype": "<f8", "shape": shape}])
    try:
        message = decode(framed(head, b'{"values": 0}'), Matrix)
    except MalformedMessageError:
        return
    assert 0 in shape
    assert message.values.shape == tuple(shape)


@pytest.mark.parametrize("dtype", ["|O", ">f8", "<i8", "|u1", "<f4", "|V8", "<c16", "<f8\0", "", 8])
def test_an_array_of_another_dtype_is_refused(dtype: object) -> None:
    def lie(head: dict[str, object]) -> None:
        head["arrays"] = [{"dtype": dtype, "shape": [30]}, {"dtype": "<f8", "shape": [30]}]

    with pytest.raises(MalformedMessageError):
        decode(rebuilt(RESULT, head=lie), GoalResult)


@pytest.mark.parametrize("index", [2, -1, True, False, 0.0, "0", None, [0], 10**30])
def test_a_field_refers_to_an_array_of_the_frame_by_its_index(index: object) -> None:
    with pytest.raises(MalformedMessageError):
        decode(
            rebuilt(RESULT, body=lambda body: body.update({"reference": 1, "response": index})),
            GoalResult,
        )


def test_two_fields_cannot_share_an_array_nor_leave_one_over() -> None:
    with pytest.raises(MalformedMessageError, match="another field has it"):
        decode(rebuilt(RESULT, body=lambda body: body.update(reference=0, response=0)), GoalResult)
    surplus = framed(header(arrays=[{"dtype": "<f8", "shape": [1]}]), b"{}", [b"\0" * 8])
    with pytest.raises(MalformedMessageError, match="that belongs to no field"):
        decode(surplus, Done)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused_in_arrays(number: float) -> None:
    poison = struct.pack("<d", number)
    with pytest.raises(MalformedMessageError, match="NaN or infinity"):
        decode(rebuilt(RESULT, raw=lambda raw: raw[:80] + poison + raw[88:]), GoalResult)
    with pytest.raises(ValidationError):
        GoalResult.model_validate({**dict(RESULT), "response": np.full(30, number)})


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused_in_the_body(number: str) -> None:
    head, body, _ = parts_of(
        encode(GoalAccepted(goal_id="g", boot_id="b", plan=RESULT.plan, wall_duration_s=0.125))
    )
    text = json.dumps(body).replace("0.125", number)
    assert number in text
    with pytest.raises(MalformedMessageError, match="wall_duration_s"):
        decode(framed(json.dumps(head).encode(), text.encode()), GoalAccepted)


def test_an_unknown_field_is_refused_by_its_name() -> None:
    with pytest.raises(MalformedMessageError, match="surprise"):
        decode(rebuilt(Done(), body=lambda body: body.update(surprise=1)), Done)
    with pytest.raises(MalformedMessageError, match="surprise"):
        decode(rebuilt(Done(), head=lambda head: head.update(surprise=1)), Done)


def test_another_type_is_refused_by_its_name() -> None:
    with pytest.raises(MalformedMessageError, match="expected Done or Refusal, got 'StopRequest'"):
        decode(encode(StopRequest(sender="me", reason="")), Done, Refusal)


def test_another_protocol_version_is_named_whatever_else_its_header_holds() -> None:
    version = PROTOCOL_VERSION + 1
    other = framed(header(protocol=version, compression="zstd"), b"\xff\xfe not even JSON")
    words = f"protocol version {version}, this side speaks {PROTOCOL_VERSION}"
    with pytest.raises(ProtocolVersionError, match=words):
        decode(other, Done)


@pytest.mark.parametrize("protocol", ["1", 1.5, None, -1, True, 2**31, 10**3000])
def test_a_version_that_is_no_number_is_malformed(protocol: object) -> None:
    sys.set_int_max_str_digits(0)
    try:
        payload = framed(header(protocol=protocol), b"{}")
    finally:
        sys.set_int_max_str_digits(4300)
    with pytest.raises(MalformedMessageError) as raised:
        decode(payload, Done)
    assert not isinstance(raised.value, ProtocolVersionError)


@settings(max_examples=30, deadline=None)
@given(samples=st.integers(0, 60), other=st.integers(0, 60), completed=st.booleans())
def test_a_result_holds_as_many_samples_as_it_may(
    samples: int, other: int, completed: bool
) -> None:
    whole = RESULT.plan.samples

    def build() -> GoalResult:
        return GoalResult.model_validate(
            {
                **dict(RESULT),
                "outcome": Outcome.COMPLETED if completed else Outcome.CANCELLED,
                "reference": np.zeros(samples + whole - 30),
                "response": np.zeros(other + whole - 30),
            }
        )

    if samples == other and (samples == 30 if completed else samples <= 30):
        assert len(build().reference) == samples + whole - 30
    else:
        with pytest.raises(ValidationError):
            build()


# Memory stays bounded and reasons stay short.


def test_an_oversized_payload_is_refused_unread() -> None:
    with pytest.raises(MalformedMessageError, match="at most 100 allowed"):
        decode(encode(RESULT), GoalResult, max_bytes=100)


@pytest.mark.parametrize("shape", [[2**26], [2**20, 2**6], [2**26, 2**26, 2**26]], ids=str)
def test_what_a_frame_claims_to_hold_is_not_allocated(shape: list[int]) -> None:
    payload = framed(header("Telemetry", arrays=[{"dtype": "<f8", "shape": shape}] * 16), b"{}")
    lengths = sealed(b"NUF1" + struct.pack("<II", 2**32 - 1, 2**32 - 1) + b"{}")
    tracemalloc.start()
    try:
        for lying in (payload, lengths):
            with pytest.raises(MalformedMessageError):
                decode(lying, Telemetry)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def test_json_longer_than_its_cap_is_not_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    body = b"[" + b"0," * (MAX_BODY_BYTES // 2 + 8) + b"0]"
    with pytest.raises(MalformedMessageError, match="larger than allowed"):
        decode(framed(header(), body), Done)
    monkeypatch.setattr(codec, "MAX_BODY_BYTES", 50)
    with pytest.raises(MalformedMessageError, match="too large to be sent"):
        encode(StopRequest(sender="me", reason="x" * 60))


def test_deeply_nested_json_is_refused() -> None:
    for opening, closing in ((b"[", b"]"), (b'{"a":', b"}")):
        body = opening * 10_000 + b"1" + closing * 10_000
        with pytest.raises(MalformedMessageError):
            decode(framed(header(), body), Done)


def test_a_message_too_large_to_be_taken_is_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codec, "MAX_MESSAGE_BYTES", 10_000)
    samples = np.zeros(1000)
    with pytest.raises(MalformedMessageError, match="too large to be sent"):
        encode(
            Telemetry(
                goal_id="g", first_sample=0, sample_time_s=0.01, reference=samples, response=samples
            )
        )


@given(sender=identifiers, reason=st.text(st.characters()) | st.text())
def test_a_stop_written_without_pydantic_is_the_stop_that_encode_writes(
    sender: str, reason: str
) -> None:
    stop = StopRequest(sender=sender, reason=reason)
    frame = stop_frame(sender, reason, order_id=stop.order_id)
    assert frame == encode(stop)
    assert decode(frame, StopRequest) == stop


def test_a_field_that_only_the_sender_knows_is_shown_without_its_control_characters() -> None:
    body = json.dumps({"\x1b[31mOWNED\n": 1}).encode()
    with pytest.raises(MalformedMessageError, match=r"\?\[31mOWNED") as raised:
        decode(framed(header(), body), Done)
    assert "\x1b" not in str(raised.value)


def test_a_refusals_reason_stays_short_whatever_was_sent() -> None:
    body = json.dumps({"x" * 50_000 + str(k): 1 for k in range(20)}).encode()
    with pytest.raises(MalformedMessageError) as raised:
        decode(framed(header(), body), Done)
    assert len(str(raised.value)) < 2000
    assert "and 16 more" in str(raised.value)


def test_headers_that_are_alike_are_validated_once() -> None:
    state = encode(Refusal(code="busy", reason="one"))
    decode(state, Refusal)
    before = codec._parse_header.cache_info()
    decode(encode(Refusal(code="busy", reason="another")), Refusal)
    after = codec._parse_header.cache_info()
    assert (after.hits, after.misses) == (before.hits + 1, before.misses)
