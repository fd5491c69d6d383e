"""Arrays as blobs: every bit comes back, and anything else is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from nufleet.orchestrator.repository.array_blob import pack_array, unpack_complex, unpack_floats
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.shared.arrays import ComplexArray, FloatArray

SHAPES = array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5)


@given(array=arrays(np.float64, SHAPES))
def test_floats_come_back_bit_for_bit(array: FloatArray) -> None:
    back = unpack_floats(pack_array(array), array.shape, "it")
    assert back.dtype == np.float64
    assert (back.shape, back.tobytes()) == (array.shape, array.tobytes())


@given(array=arrays(np.complex128, SHAPES))
def test_complex_numbers_come_back_bit_for_bit(array: ComplexArray) -> None:
    back = unpack_complex(pack_array(array), array.shape, "it")
    assert back.dtype == np.complex128
    assert (back.shape, back.tobytes()) == (array.shape, array.tobytes())


def test_arrays_in_another_order_or_byte_order_come_back_as_the_same_numbers() -> None:
    array = np.arange(6.0).reshape(2, 3).astype(">f8")
    assert np.array_equal(unpack_floats(pack_array(array.T), (3, 2), "it"), array.T)


@given(array=arrays(np.float64, st.integers(0, 4)), data=st.data())
def test_any_changed_byte_is_found(array: FloatArray, data: st.DataObject) -> None:
    blob = bytearray(pack_array(array))
    place = data.draw(st.integers(0, len(blob) - 1))
    blob[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(DamagedRecordError, match="it"):
        unpack_floats(bytes(blob), array.shape, "it")


@given(array=arrays(np.float64, st.integers(0, 4)), data=st.data())
def test_any_cut_or_addition_is_found(array: FloatArray, data: st.DataObject) -> None:
    blob = pack_array(array)
    shorter = blob[: data.draw(st.integers(0, len(blob) - 1))]
    for wrong in (shorter, blob + data.draw(st.binary(min_size=1, max_size=9))):
        with pytest.raises(DamagedRecordError):
            unpack_floats(wrong, array.shape, "it")


def test_another_shape_or_type_than_expected_is_refused() -> None:
    blob = pack_array(np.zeros(4))
    for shape in ((5,), (2, 2), (3,), (2**61,)):
        with pytest.raises(DamagedRecordError, match="shape"):
            unpack_floats(blob, shape, "it")
    with pytest.raises(DamagedRecordError, match="c16"):
        unpack_complex(blob, (2,), "it")
