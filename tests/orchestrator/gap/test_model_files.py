"""Model files are read exactly or refused with the file, the field and what was expected."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from nufleet.orchestrator.gap.measured_response import MeasuredResponse
from nufleet.orchestrator.gap.model_files import (
    SIZE_MAX_BYTES,
    ModelFileError,
    read_model,
    write_response,
)
from nufleet.shared.models.transfer_models import StateSpace


def read(tmp_path: Path, document: object, name: str = "model.json") -> StateSpace:
    path = tmp_path / name
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    model = read_model(path)
    assert isinstance(model, StateSpace)
    return model


def response(model: StateSpace, point: complex) -> np.ndarray:
    resolvent = point * np.eye(model.states) - model.a
    return np.asarray(model.c @ np.linalg.solve(resolvent, model.b.astype(complex)) + model.d)


def test_a_transfer_function_is_read(tmp_path: Path) -> None:
    model = read(tmp_path, {"num": [1, 2], "den": [1, 3, 4], "dt": 0.1})
    assert model.dt_s == 0.1
    assert response(model, 0.5j)[0, 0] == pytest.approx((2 + 0.5j) / (3.75 + 1.5j))


def test_without_dt_time_is_continuous(tmp_path: Path) -> None:
    assert read(tmp_path, {"num": [1], "den": [1, 1]}).dt_s == 0.0
    assert read(tmp_path, {"num": [1], "den": [1, 1], "dt": 0}).dt_s == 0.0


def test_a_matrix_of_transfer_functions_is_read(tmp_path: Path) -> None:
    model = read(
        tmp_path, {"num": [[[1], [2]], [[3], [4, 5]]], "den": [[[1, 1], [1]], [[1, 2], [1, 3]]]}
    )
    expected = [[1 / (1 + 2j), 2], [3 / (2 + 2j), (5 + 8j) / (3 + 2j)]]
    np.testing.assert_allclose(response(model, 2j), expected)


def test_a_state_space_model_is_read(tmp_path: Path) -> None:
    matrices = {"A": [[0, 1], [-2, -3]], "B": [[0], [1]], "C": [[1, 0]], "D": [[0.5]]}
    model = read(tmp_path, {**matrices, "dt": 0.02})
    for name, matrix in matrices.items():
        np.testing.assert_array_equal(getattr(model, name.lower()), matrix)
    assert model.dt_s == 0.02


def test_a_state_space_model_without_states_is_a_gain(tmp_path: Path) -> None:
    model = read(tmp_path, {"A": [], "B": [], "C": [[], []], "D": [[1, 2, 3], [4, 5, 6]]})
    assert (model.states, model.inputs, model.outputs) == (0, 3, 2)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (
            {"num": [1, "x"], "den": [1, 1]},
            r"model.json: num\[1\]: must be a valid number, got 'x'",
        ),
        ({"num": [1], "den": [1, None]}, r"den\[1\]: must be a valid number, got None"),
        ('{"num": [1], "den": [1, NaN]}', r"den\[1\]: must be a finite number, got nan"),
        ('{"num": [1], "den": [1, 1e999]}', r"den\[1\]: must be a finite number, got inf"),
        ({"num": [], "den": [1]}, r"num: Tuple should have at least 1 item"),
        ({"num": [1]}, r"den: missing"),
        ({"num": [1], "den": [1, 1], "gain": 2}, r"gain: unknown"),
        ({"num": [1], "den": [1, 1], "dt": -1}, r"dt: must be greater than or equal to 0, got -1"),
        ({"num": [1], "den": [1, 1], "dt": True}, r"dt: must be a valid number, got True"),
        ({"num": [1, 0, 0], "den": [1, 1]}, r"model.json: improper transfer function"),
        ({"num": [1], "den": [0, 0]}, r"model.json: the denominator .* is zero"),
        ({"num": [[[1]], [[1], [1]]], "den": [[[1]], [[1]]]}, r"must be full matrices"),
        ({"num": [[[1]]], "den": [1, 1]}, r"den\[0\]: must be a valid array, got 1"),
        ({"A": [[1, 2]], "B": [[1]], "C": [[1]], "D": [[1]]}, r"A is 1 × 2, expected 1 × 1"),
        ({"A": [[1, 2], [3]], "B": [[1]], "C": [[1]], "D": [[1]]}, r"rows of A differ in length"),
        ({"A": [[1]], "B": [[1], [2]], "C": [[1]], "D": [[1]]}, r"B is 2 × 1, expected 1 × 1"),
        ({"A": [[1]], "B": [[1]], "C": [[1]]}, r"D: missing"),
        ({"zeros": [1], "poles": [2]}, r"expected an object with the fields num and den"),
        ([1, 2], r"expected an object with the fields num and den"),
        ("{", r"model.json: not JSON"),
        ("[" * 100_000, r"model.json: not JSON"),
        (
            {"omega_rad_s": [1], "real": [1], "imag": [1]},
            r"omega_rad_s: Tuple should have at least 2",
        ),
        ({"omega_rad_s": [1, 1], "real": [1, 1], "imag": [1, 1]}, r"must rise"),
        ({"omega_rad_s": [1, 2], "real": [1, 1, 1], "imag": [1, 1]}, r"real has 3 entries"),
        (
            {"omega_rad_s": [-1, 2], "real": [1, 1], "imag": [1, 1]},
            r"omega_rad_s\[0\]: must be greater",
        ),
        (
            {"omega_rad_s": [1, 2], "real": [1, 1], "imag": [1, 1], "variance": [0.1]},
            r"variance has 1 entries, omega_rad_s 2",
        ),
    ],
)
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, document: object, message: str) -> None:
    with pytest.raises(ModelFileError, match=message) as refused:
        read(tmp_path, document)
    assert refused.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"expected the header omega_rad_s,real,imag .* got nothing"),
        ("omega,re,im\n1,2,3\n", r"got omega,re,im"),
        ("omega_rad_s,real,imag\n1,2\n", r"data row 1: expected 3 columns, got 2"),
        ("omega_rad_s,real,imag\n1,2,3\n2,x,3\n", r"data row 2: could not convert .* 'x'"),
        (
            "omega_rad_s,real,imag\n1,2,3\n2,nan,3\n",
            r"real\[1\]: must be a finite number, got nan",
        ),
        ("omega_rad_s,real,imag\n1,2,3\n", r"omega_rad_s: Tuple should have at least 2 items"),
        ("omega_rad_s,real,imag\n", r"omega_rad_s: Tuple should have at least 2 items"),
    ],
)
def test_a_table_that_is_no_response_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "response.csv"
    path.write_text(text)
    with pytest.raises(ModelFileError, match=message):
        read_model(path)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=r"missing\.json: No such file"):
        read_model(tmp_path / "missing.json")
    with pytest.raises(ModelFileError, match="Is a directory"):
        read_model(tmp_path)
    (tmp_path / "model.txt").write_text("{}")
    with pytest.raises(ModelFileError, match=r"expected a \.json or \.csv file"):
        read_model(tmp_path / "model.txt")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelFileError, match="not a text file in UTF-8"):
        read_model(tmp_path / "binary.json")


def test_a_file_too_large_to_be_a_model_is_not_even_read(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(SIZE_MAX_BYTES + 1)
    with pytest.raises(ModelFileError, match="larger than 64 MiB"):
        read_model(path)


@pytest.mark.parametrize("suffix", [".json", ".csv"])
@pytest.mark.parametrize("with_variance", [True, False])
def test_a_response_comes_back_as_it_was_written(
    tmp_path: Path, suffix: str, with_variance: bool
) -> None:
    rng = np.random.default_rng(61)
    written = MeasuredResponse(
        np.sort(rng.uniform(0.1, 10, 20)),
        rng.standard_normal(20) + 1j * rng.standard_normal(20),
        rng.uniform(0, 1e-9, 20) if with_variance else None,
    )
    path = tmp_path / f"response{suffix}"
    write_response(path, written)
    found = read_model(path)
    assert isinstance(found, MeasuredResponse)
    np.testing.assert_array_equal(found.omega_rad_s, written.omega_rad_s)
    np.testing.assert_array_equal(found.z, written.z)
    if written.variance is None:
        assert found.variance is None
    else:
        assert found.variance is not None
        np.testing.assert_array_equal(found.variance, written.variance)


@pytest.mark.parametrize(
    ("omega", "z", "message"),
    [
        ([1.0], [1.0], "at least 2 items"),
        ([2.0, 1.0], [1.0, 1.0], "must rise"),
        ([1.0, 2.0], [1.0, float("nan")], r"real\[1\]: must be a finite number"),
    ],
)
def test_a_response_that_could_not_be_read_back_is_not_written(
    tmp_path: Path, omega: list[float], z: list[float], message: str
) -> None:
    path = tmp_path / "response.csv"
    with pytest.raises(ModelFileError, match=message):
        write_response(path, MeasuredResponse(np.array(omega), np.array(z, dtype=complex)))
    assert not path.exists()
    good = MeasuredResponse(np.array([1.0, 2.0]), np.array([1.0, 1j]))
    with pytest.raises(ModelFileError, match=r"ends in \.json or \.csv"):
        write_response(tmp_path / "response.mat", good)
