"""Reads and writes files that hold a model or a measured frequency response.

A JSON file holds one object, whose fields determine its kind:
- a transfer function, as in python-control: `num`, `den` from the highest power down, for several
  inputs and outputs num[i][j] from input j to output i; `dt` in s, 0 or absent in continuous time;
- a state-space model: `A`, `B`, `C`, `D` as lists of rows, and `dt`;
- a measured response: `omega_rad_s`, `real`, `imag` and, where known, `variance`, E|ẑ − z|².
CSV holds a measured response, with those four or three names as its header.

Three lines pass a measured response to python-control::

    measured = read_model(Path("response.csv"))
    response = control.frd(measured.z, measured.omega_rad_s, name="robot")
    control.bode_plot(response)
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError, model_validator

from nufleet.orchestrator.gap.measured_response import MeasuredResponse
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.realization import transfer_function, transfer_matrix
from nufleet.shared.models.transfer_models import ModelError, StateSpace
from nufleet.shared.strict import NonNegative, Strict, in_words

SIZE_MAX_BYTES = 64 * 2**20

Polynomial = Annotated[tuple[float, ...], Field(min_length=1, max_length=64)]
Rows = Annotated[tuple[tuple[float, ...], ...], Field(max_length=256)]
Column = Annotated[tuple[float, ...], Field(min_length=2, max_length=1_000_000)]


class ModelFileError(InvalidInputError):
    """A model file cannot be used; the message names the file, the field and the expectation."""


class TransferFunctionFile(Strict):
    """A transfer function num/den with one input and one output."""

    num: Polynomial
    """Coefficients of the numerator, from the highest power down."""
    den: Polynomial
    """Coefficients of the denominator, from the highest power down."""
    dt: NonNegative = 0.0
    """Sample time in s; 0 in continuous time."""

    def model(self) -> StateSpace:
        """Return the model that the file describes."""
        return transfer_function(self.num, self.den, self.dt)


class TransferMatrixFile(Strict):
    """A matrix of transfer functions num[i][j]/den[i][j] from input j to output i."""

    num: Annotated[tuple[tuple[Polynomial, ...], ...], Field(min_length=1, max_length=64)]
    """Coefficients of the numerators, from the highest power down, by output and input."""
    den: Annotated[tuple[tuple[Polynomial, ...], ...], Field(min_length=1, max_length=64)]
    """Coefficients of the denominators, in the same order."""
    dt: NonNegative = 0.0
    """Sample time in s; 0 in continuous time."""

    def model(self) -> StateSpace:
        """Return the model that the file describes."""
        return transfer_matrix(self.num, self.den, self.dt)


class StateSpaceFile(Strict):
    """A state-space model with A, B, C and D as lists of rows, and the sample time `dt` in s."""

    a: Rows = Field(alias="A")
    """Rows of A, shape (states, states)."""
    b: Rows = Field(alias="B")
    """Rows of B, shape (states, inputs)."""
    c: Rows = Field(alias="C")
    """Rows of C, shape (outputs, states)."""
    d: Rows = Field(alias="D", min_length=1)
    """Rows of D, shape (outputs, inputs)."""
    dt: NonNegative = 0.0
    """Sample time in s; 0 in continuous time."""

    @model_validator(mode="after")
    def _rectangular(self) -> StateSpaceFile:
        for name, rows in (("A", self.a), ("B", self.b), ("C", self.c), ("D", self.d)):
            if len({len(row) for row in rows}) > 1:
                raise ValueError(f"the rows of {name} differ in length")
        return self

    def model(self) -> StateSpace:
        """Return the model that the file describes."""
        # Without states, A and B have no rows, so the file cannot state their numbers of columns.
        a = np.array(self.a) if self.a else np.empty((0, 0))
        b = np.array(self.b) if self.b else np.empty((0, len(self.d[0])))
        return StateSpace(a, b, np.array(self.c), np.array(self.d), self.dt)


class FrequencyResponseFile(Strict):
    """A measured response z(ω): columns of equal length with at least two rising frequencies.

    The frequencies are in rad/s, and `variance` is E|ẑ − z|².
    """

    omega_rad_s: Annotated[tuple[NonNegative, ...], Field(min_length=2, max_length=1_000_000)]
    """Frequencies in rad/s, ascending."""
    real: Column
    """Real part of z at each frequency."""
    imag: Column
    """Imaginary part of z at each frequency."""
    variance: Annotated[tuple[NonNegative, ...], Field(max_length=1_000_000)] | None = None
    """Variance E|ẑ − z|² at each frequency; None if it is unknown."""

    @model_validator(mode="after")
    def _columns_agree(self) -> FrequencyResponseFile:
        columns = {"real": self.real, "imag": self.imag, "variance": self.variance}
        for name, column in columns.items():
            if column is not None and len(column) != len(self.omega_rad_s):
                raise ValueError(
                    f"{name} has {len(column)} entries, omega_rad_s {len(self.omega_rad_s)}"
                )
        if not (np.diff(self.omega_rad_s) > 0).all():
            raise ValueError("omega_rad_s must rise from entry to entry")
        return self

    def model(self) -> MeasuredResponse:
        """Return the measured response that the file describes."""
        return MeasuredResponse(
            np.array(self.omega_rad_s),
            np.array(self.real) + 1j * np.array(self.imag),
            None if self.variance is None else np.array(self.variance),
        )


def read_model(path: Path) -> StateSpace | MeasuredResponse:
    """Return the model or the measured response in a .json or .csv file.

    Raises:
        ModelFileError: The file is missing, too large or malformed, or its model is inconsistent;
            the message names the file, the field and the expectation.
    """
    try:
        if path.stat().st_size > SIZE_MAX_BYTES:
            raise ModelFileError(f"{path}: larger than {SIZE_MAX_BYTES // 2**20} MiB")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ModelFileError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ModelFileError(f"{path}: not a text file in UTF-8") from error
    suffix = path.suffix.lower()
    if suffix not in {".json", ".csv"}:
        raise ModelFileError(f"{path}: expected a .json or .csv file")
    try:
        described = _from_json(path, text) if suffix == ".json" else _from_csv(path, text)
        return described.model()
    except ValidationError as error:
        raise ModelFileError(_explain(path, error)) from error
    except ModelError as error:
        raise ModelFileError(f"{path}: {error}") from error


def write_response(path: Path, response: MeasuredResponse) -> None:
    """Write a measured response as .json or .csv; reading it back gives the same numbers.

    Args:
        path: File to write; its suffix selects the format.
        response: Response to write.

    Raises:
        ModelFileError: The suffix is another one, a value is not finite, there are fewer than two
            frequencies, or the frequencies do not rise.
        OSError: The file cannot be written.
    """
    columns = {
        "omega_rad_s": response.omega_rad_s,
        "real": response.z.real,
        "imag": response.z.imag,
    }
    if response.variance is not None:
        columns["variance"] = response.variance
    lists = {name: tuple(map(float, column)) for name, column in columns.items()}
    try:
        FrequencyResponseFile.model_validate(lists)
    except ValidationError as error:
        raise ModelFileError(_explain(path, error)) from error
    if path.suffix.lower() == ".json":
        path.write_text(json.dumps(lists) + "\n", encoding="utf-8")
    elif path.suffix.lower() == ".csv":
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(lists)
            writer.writerows(zip(*lists.values(), strict=True))
    else:
        raise ModelFileError(f"{path}: expected a name that ends in .json or .csv")


ModelFile = TransferFunctionFile | TransferMatrixFile | StateSpaceFile | FrequencyResponseFile


def _from_json(path: Path, text: str) -> ModelFile:
    try:
        document: Any = json.loads(text)
    except (ValueError, RecursionError) as error:  # a number may also be too long for Python
        raise ModelFileError(f"{path}: not JSON: {error}") from error
    fields = document.keys() if isinstance(document, dict) else set()
    if "num" in fields or "den" in fields:
        num = document.get("num")
        nested = isinstance(num, list) and any(isinstance(entry, list) for entry in num)
        kind: type[ModelFile] = TransferMatrixFile if nested else TransferFunctionFile
    elif fields & {"A", "B", "C", "D"}:
        kind = StateSpaceFile
    elif fields & {"omega_rad_s", "real", "imag"}:
        kind = FrequencyResponseFile
    else:
        raise ModelFileError(
            f"{path}: expected an object with the fields num and den (a transfer function), A, B,"
            " C and D (a state-space model) or omega_rad_s, real and imag (a measured response)"
        )
    return kind.model_validate_json(text)


def _from_csv(path: Path, text: str) -> FrequencyResponseFile:
    names = ["omega_rad_s", "real", "imag", "variance"]
    try:
        header, *rows = [row for row in csv.reader(text.splitlines()) if row] or [[]]
    except csv.Error as error:
        raise ModelFileError(f"{path}: not a CSV file: {error}") from error
    header = [name.strip() for name in header]
    if header not in (names, names[:3]):
        raise ModelFileError(
            f"{path}: expected the header omega_rad_s,real,imag or omega_rad_s,real,imag,variance,"
            f" got {','.join(header)[:80] or 'nothing'}"
        )
    numbers = []
    for place, row in enumerate(rows, start=1):
        if len(row) != len(header):
            raise ModelFileError(
                f"{path}: data row {place}: expected {len(header)} columns, got {len(row)}"
            )
        try:
            numbers.append([float(entry) for entry in row])
        except ValueError as error:
            raise ModelFileError(f"{path}: data row {place}: {error}") from error
    columns = zip(*numbers, strict=True) if numbers else [()] * len(header)
    return FrequencyResponseFile.model_validate(dict(zip(header, columns, strict=True)))


def _explain(path: Path, error: ValidationError) -> str:
    """Return a message with the first validation error and the number of further ones."""
    details = error.errors(include_url=False)
    first = details[0]
    field = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in first["loc"])
    message = in_words(first["type"], first["msg"], first["loc"])
    if first["loc"] and not isinstance(first["input"], dict | list | tuple):
        message += f", got {first['input']!r:.40}"
    others = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return f"{path}: {field.removeprefix('.') + ': ' if field else ''}{message}{others}"
