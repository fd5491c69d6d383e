"""Frequency tests that a robot has flown and not learned from yet.

What a test teaches a robot of itself takes longer to compute than to store, and only those that fly
paths ever ask for it. So a robot keeps its tests as they are, and learns from all of them when it
is asked.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from nufleet.robot_agent.flight.cross_axes import Crosses, crosses_in
from nufleet.robot_agent.flight.own_model import basis_of, evidence_in
from nufleet.robot_agent.flight.state_model import StateEvidence, state_evidence
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import MalformedMessageError, ProtocolVersionError
from nufleet.shared.experience.file import digest
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.private_files import synchronise_folder, write_all
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Name, Positive
from nufleet.shared.wire.codec import Float64Array, Message, decode, encode

UNREAD_BYTES_MAX = 2**20
"""Size of the tests that are kept; a robot learns from them all before it keeps another."""

_PREFIX = "unread-"
_SUFFIX = ".learned"
_SHA256_BYTES, _LENGTH_BYTES = 32, 8

_log = logging.getLogger(__name__)


class UnreadTest(Message):
    """What was sent and measured in a frequency test that was completed."""

    spec: RobotSpec
    """Description of the robot at that time."""
    state_names: tuple[str, ...]
    """Names of the states that it measures."""
    axes: tuple[Name, ...]
    """Names of the axes that moved."""
    top_rad_s: tuple[Positive, ...]
    """Highest frequency on each of them."""
    references: Float64Array
    """References sent, shape (samples, axes that moved), in the axes' units."""
    outputs: Float64Array
    """Outputs measured before each reference acted, in the same shape."""
    observed: Float64Array
    """Samples at which the states were observed, shape (observations,)."""
    states: Float64Array
    """States there, shape (observations, axes that moved, states)."""

    @property
    def flown_s(self) -> float:
        """Duration of the test."""
        return len(self.references) * self.spec.sample_time_s

    def shown(
        self,
    ) -> tuple[Mapping[str, Evidence], Mapping[str, StateEvidence], Mapping[str, Crosses]]:
        """Return what the test shows of its axes, of their states, and of others on them.

        Raises:
            InvalidInputError: The record is too short, or holds numbers that cannot be right.
        """
        names = [axis.name for axis in self.spec.axes]
        columns = [names.index(axis) for axis in self.axes]
        references, outputs = np.zeros((2, len(self.references), len(names)))
        references[:, columns], outputs[:, columns] = self.references, self.outputs
        crosses, alone = crosses_in(basis_of(self.spec), names, references, outputs)
        return evidence_in(self.spec, references, alone), self._states(), crosses

    def _states(self) -> dict[str, StateEvidence]:
        everywhere = np.full((len(self.outputs), *self.states.shape[1:]), np.nan)
        everywhere[self.observed.astype(int)] = self.states
        found = {}
        for i, (axis, top) in enumerate(zip(self.axes, self.top_rad_s, strict=True)):
            step_s, states = self.spec.sample_time_s, everywhere[:, i]
            seen = state_evidence(self.state_names, self.outputs[:, i], states, step_s, top)
            if seen is not None:
                found[axis] = seen
        return found


def unread_test(
    spec: RobotSpec,
    state_names: tuple[str, ...],
    axes: Mapping[str, float],
    references: FloatArray,
    outputs: FloatArray,
    states: FloatArray | None,
) -> UnreadTest:
    """Return a test to be learned from later.

    Args:
        spec: Description of the robot.
        state_names: Names of the states that it measures.
        axes: Highest frequency on each axis that moved, in rad/s, by the axis's name.
        references: References sent, shape (samples, axes that moved), in the axes' units.
        outputs: Outputs measured before each reference acted, in the same shape.
        states: States, shape (samples, axes that moved, states), NaN where they were not observed;
            None if they were nowhere.
    """
    if states is None:
        states = np.empty((len(outputs), len(axes), 0))
        seen = np.empty(0, dtype=int)
    else:
        seen = np.flatnonzero(np.isfinite(states).all(axis=(1, 2)))
    return UnreadTest(
        spec=spec,
        state_names=state_names,
        axes=tuple(axes),
        top_rad_s=tuple(axes.values()),
        references=references,
        outputs=outputs,
        observed=seen.astype(np.float64),
        states=states[seen],
    )


class UnreadTests:
    """The tests of one robot that it has not learned from, in a file that is appended to.

    Its name says which model of itself they add to. Once that has been replaced by one that has
    learned from them, the file counts no more, also if a crash left it in place. A test that was
    not written to its end is cut off, and those of another version of the protocol are left out: an
    agent that was upgraded starts all the same, and learns from its next motions.
    """

    def __init__(self, folder: Path | None, adds_to: str) -> None:
        """Find the tests that are there.

        Args:
            folder: Folder of the robot's learned models; None to keep the tests in memory.
            adds_to: Digest of the stored model of itself.

        Raises:
            OSError: The folder cannot be read or written.
        """
        self._folder = folder
        self._kept: list[bytes] = []
        self._flown_s: list[tuple[tuple[str, ...], float]] = []
        self._size_bytes = 0
        self._path = self._of(adds_to)
        for path in [] if folder is None else folder.glob(f"{_PREFIX}*{_SUFFIX}"):
            if path != self._path or path.is_symlink():
                path.unlink()
        try:
            for payload in self._payloads():
                self._count(decode(payload, UnreadTest), payload)
        except ProtocolVersionError:
            _log.warning("%s: tests of another version of nufleet teach nothing", self._path)
            self.forget(adds_to)

    def __len__(self) -> int:
        return len(self._flown_s)

    @property
    def flown_s(self) -> Mapping[str, float]:
        """Duration in s of these tests, by the names of the axes that they moved."""
        total: dict[str, float] = {}
        for axes, seconds in self._flown_s:
            for axis in axes:
                total[axis] = total.get(axis, 0.0) + seconds
        return total

    def add(self, test: UnreadTest) -> bool:
        """Keep a test; return whether there is room for it.

        A test in a folder outlasts the process. A power failure may cut off the last tests, which
        a robot would only learn less from: no robot waits for the disk to learn.

        Raises:
            OSError: It cannot be stored.
        """
        try:
            payload = encode(test)
        except MalformedMessageError:  # it is too large for a message, and so for this
            return False
        if self._size_bytes + len(payload) > UNREAD_BYTES_MAX:
            return False
        if self._path is None:
            self._kept.append(payload)
        else:
            self._append(self._path, payload)
        self._count(test, payload)
        return True

    def tests(self) -> list[UnreadTest]:
        """Return all tests, in their order.

        Raises:
            OSError: They cannot be read.
        """
        return [decode(payload, UnreadTest) for payload in self._payloads()]

    def forget(self, adds_to: str) -> None:
        """Forget all tests; further ones add to another model.

        Raises:
            OSError: Their file cannot be removed.
        """
        if self._path is not None:
            self._path.unlink(missing_ok=True)
        self._kept, self._flown_s, self._size_bytes = [], [], 0
        self._path = self._of(adds_to)

    def _of(self, adds_to: str) -> Path | None:
        if self._folder is None:
            return None
        return self._folder / f"{_PREFIX}{adds_to[:16]}{_SUFFIX}"

    def _count(self, test: UnreadTest, payload: bytes) -> None:
        self._flown_s.append((test.axes, test.flown_s))
        self._size_bytes += len(payload)

    def _append(self, path: Path, payload: bytes) -> None:
        length = len(payload).to_bytes(_LENGTH_BYTES, "big")
        frame = bytes.fromhex(digest(payload)) + length + payload
        new = not path.exists()
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        descriptor = os.open(path, flags, 0o600)
        try:
            size = os.fstat(descriptor).st_size
            try:
                write_all(descriptor, frame)
            except OSError:
                os.ftruncate(descriptor, size)
                raise
        finally:
            os.close(descriptor)
        if new:
            synchronise_folder(path.parent)

    def _payloads(self) -> list[bytes]:
        """Return the encoded tests, and cut off what was not written to its end."""
        if self._path is None or not self._path.exists():
            return list(self._kept)
        data = self._path.read_bytes()
        found, start = [], 0
        while start < len(data):
            begins = start + _SHA256_BYTES + _LENGTH_BYTES
            ends = begins + int.from_bytes(data[start + _SHA256_BYTES : begins], "big")
            payload = data[begins:ends]
            if ends > len(data) or data[start : start + _SHA256_BYTES] != bytes.fromhex(
                digest(payload)
            ):
                left = len(data) - start
                _log.warning("%s: the last %d bytes are no whole test", self._path, left)
                os.truncate(self._path, start)
                break
            found.append(payload)
            start = ends
        return found
