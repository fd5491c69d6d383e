"""A robot's learned models on disk: its own experiences, its prior and its model of itself.

They lie in a folder of the robot's own, so that they survive a restart of its agent. Every file is
replaced as a whole and begins with the sha256 of its content, so that no damage goes unnoticed.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from nufleet.robot_agent.flight.cross_axes import Crosses
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.own_model import (
    AxisRecord,
    Settled,
    settle,
    with_unexplained,
)
from nufleet.robot_agent.flight.state_model import StateEvidence, StateModel, state_model
from nufleet.robot_agent.flight.unread import UnreadTest, UnreadTests
from nufleet.shared.errors import InvalidInputError, MalformedMessageError, NufleetError
from nufleet.shared.experience.file import (
    EXPERIENCE_BYTES_MAX,
    Experience,
    decode_experience,
    digest,
)
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.models.unexplained import Unexplained
from nufleet.shared.private_files import make_private_folder, synchronise_folder, write_privately
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Name, describe_validation
from nufleet.shared.wire.motions import MIXTURE_MAX

PRIOR = "prior"
_PRIORS = (PRIOR, *(f"{PRIOR}-{place}" for place in range(1, MIXTURE_MAX)))
_OWN = "own"
_SUFFIX = ".learned"
_SHA256_BYTES = 32
_OWN_BYTES_MAX = 64 * 2**20
_ARCHITECTURES: tuple[Architecture, ...] = ("state", "preview")
_RECORDS: TypeAdapter[dict[Name, AxisRecord]] = TypeAdapter(dict[Name, AxisRecord])
_NOTHING = digest(b"")

_log = logging.getLogger(__name__)


class MemoryFolderError(NufleetError):
    """A robot's learned models cannot be stored, or a stored file is damaged."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A stored experience: its file, and the model in it."""

    sha256: str
    """Digest of `payload`, in hexadecimal."""

    payload: bytes
    """Content of the experience's file."""

    manifest: ExperienceManifest
    """Description of the experience, from the file."""

    inverse: NetworkInverse
    """Inverse model of the experience, ready to be evaluated."""


class Memory:
    """The learned models of one robot; usable from many threads.

    The robot offers one experience of its own for each architecture, and flies with one prior or
    with a mixture of several.
    """

    def __init__(self, folder: Path | None) -> None:
        """Read the files that are there.

        Args:
            folder: Folder of the robot, created if missing; None keeps everything in memory only,
                so that nothing survives the process.

        Raises:
            MemoryFolderError: A file is damaged, or the folder cannot be made.
        """
        self._folder = folder
        self._lock = threading.Lock()
        self._kept: dict[str, Kept] = {}
        self._records: Mapping[str, AxisRecord] = {}
        self._settled: Settled | None = None
        self._own_sha256 = _NOTHING
        self._unread = UnreadTests(None, _NOTHING)
        if folder is not None:
            try:
                make_private_folder(folder)
                self._read(folder)
                self._unread = UnreadTests(folder, self._own_sha256)
            except MalformedMessageError as error:
                raise MemoryFolderError(
                    f"{folder}: tests cannot be read: {error}; remove `unread-*{_SUFFIX}` there, "
                    "the robot relearns from its next motions"
                ) from error
            except OSError as error:
                raise MemoryFolderError(
                    f"{folder}: {error.strerror}; choose a writable folder with NUFLEET_STATE, or "
                    "free or repair the disk"
                ) from error

    def exported(self) -> tuple[bytes, tuple[bytes, ...]]:
        """Return what another process needs to fly as this robot does: see `imported`.

        These are what is known of each axis, as JSON, and the files of all priors in their order.

        Raises:
            MemoryFolderError: What was found cannot be stored.
        """
        with self._lock:
            self._read_tests()
            records = _RECORDS.dump_json(dict(self._records))
        return records, tuple(prior.payload for prior in self.priors)

    @staticmethod
    def imported(records: bytes, priors: Sequence[bytes]) -> Memory:
        """Return a memory that stores nothing, with what another one exported.

        Raises:
            MalformedMessageError: It was not exported by a memory.
        """
        memory = Memory(None)
        try:
            memory._records = _RECORDS.validate_json(records)
        except ValidationError as error:
            raise MalformedMessageError(describe_validation(error)) from error
        for payload in priors:
            memory.keep_prior(payload, digest(payload), beside=True)
        return memory

    @property
    def experiences(self) -> tuple[Kept, ...]:
        """Experiences learned on this robot, at most one per architecture."""
        with self._lock:
            return tuple(self._kept[name] for name in _ARCHITECTURES if name in self._kept)

    @property
    def prior(self) -> Kept | None:
        """Experience that was transferred to the robot, the first of several; None without one."""
        return next(iter(self.priors), None)

    @property
    def priors(self) -> tuple[Kept, ...]:
        """All experiences that were transferred to the robot, in their order."""
        with self._lock:
            return tuple(self._kept[name] for name in _PRIORS if name in self._kept)

    @property
    def flown_s(self) -> Mapping[str, float]:
        """Duration in s of the motions that involve each axis, by its name; empty before any."""
        with self._lock:
            flown_s = dict(self._unread.flown_s)
            for axis, record in self._records.items():
                known = (e.flown_s for e in (record.settled, record.new) if e is not None)
                flown_s[axis] = sum(known, flown_s.get(axis, 0.0))
            return flown_s

    def own_model(self, spec: RobotSpec) -> Settled:
        """Return the robot's model of itself; the first call after a motion takes a while.

        Args:
            spec: Description of the robot.

        Raises:
            MemoryFolderError: What was found cannot be stored.
        """
        with self._lock:
            self._read_tests()
            if self._settled is None:
                settled = settle(self._records, spec)
                if dict(settled.records) != self._records:
                    self._keep_records(settled.records)
                self._settled = settled
            return self._settled

    def find(self, sha256: str) -> Kept | None:
        """Return the experience or prior with that digest; None when there is none."""
        with self._lock:
            return next((kept for kept in self._kept.values() if kept.sha256 == sha256), None)

    def keep_experience(self, payload: bytes, sha256: str) -> Kept:
        """Store an experience learned on this robot, replacing the one of the same architecture.

        Args:
            payload: Content of the experience's file.
            sha256: Digest of the payload, in hexadecimal.

        Returns:
            The experience as it was stored.

        Raises:
            MalformedMessageError: The payload is not an experience with that digest.
            MemoryFolderError: The experience cannot be stored.
        """
        kept = _checked(payload, sha256)
        return self._keep(kept.manifest.layout.architecture, kept)

    def keep_prior(self, payload: bytes, sha256: str, *, beside: bool = False) -> Kept:
        """Store a prior that the robot flies with.

        Args:
            payload: Content of the experience's file.
            sha256: Digest of the payload, in hexadecimal.
            beside: True if it joins the priors that there are, in place of an earlier one of the
                same source; False if it takes the place of all.

        Raises:
            MalformedMessageError: The payload is not an experience with that digest.
            MemoryFolderError: The prior cannot be stored, or there is no room beside the others.
        """
        kept = _checked(payload, sha256)
        if not beside:
            # The others go first: a crash in between must not leave them beside the new one.
            self._forget(_PRIORS[1:])
            return self._keep(PRIOR, kept)
        source = kept.manifest.robot
        with self._lock:
            same = (
                n for n in _PRIORS if n in self._kept and self._kept[n].manifest.robot == source
            )
            free = (n for n in _PRIORS if n not in self._kept)
            name = next(same, None) or next(free, None)
        if name is None:
            raise MemoryFolderError(f"it holds {MIXTURE_MAX} priors, which is the most it can")
        return self._keep(name, kept)

    def forget_prior(self) -> None:
        """Remove all priors; the robot flies without one from now on.

        Raises:
            MemoryFolderError: A stored prior cannot be removed.
        """
        self._forget(_PRIORS)

    def _forget(self, names: tuple[str, ...]) -> None:
        with self._lock:
            for name in names:
                if name not in self._kept:
                    continue
                if self._folder is not None:
                    try:
                        (self._folder / f"{name}{_SUFFIX}").unlink(missing_ok=True)
                        synchronise_folder(self._folder)
                    except OSError as error:
                        raise MemoryFolderError(
                            f"{self._folder}: the prior cannot be removed: {error.strerror}"
                        ) from error
                del self._kept[name]

    def states(self, spec: RobotSpec, names: tuple[str, ...]) -> StateModel:
        """Return how the robot's states follow from its outputs, as far as it has observed them.

        Args:
            spec: Description of the robot.
            names: Names of the states that it measures.
        """
        model = self.own_model(spec).model
        noise = [0.0] * len(spec.axes) if model is None else [b.noise_std for b in model.axes]
        with self._lock:
            seen = {n: r.states for n, r in self._records.items() if r.states is not None}
        return state_model(names, seen, [axis.name for axis in spec.axes], noise)

    def learn(
        self,
        evidence: Mapping[str, Evidence],
        states: Mapping[str, StateEvidence] | None = None,
        crosses: Mapping[str, Crosses] | None = None,
    ) -> None:
        """Store what a motion shows about some axes, by the axes' names.

        Args:
            evidence: Evidence about each axis's own response.
            states: What it shows of their states.
            crosses: What it shows of what other axes do to each.

        Raises:
            MemoryFolderError: It cannot be stored.
        """
        with self._lock:
            self._read_tests()
            self._keep_records(_with_new(self._records, evidence, states or {}, crosses or {}))
            self._settled = None

    def keep_test(self, test: UnreadTest) -> None:
        """Store a frequency test, from which the robot learns when it next looks at its model.

        Raises:
            MemoryFolderError: It cannot be stored.
        """
        with self._lock:
            try:
                if not self._unread.add(test):
                    self._read_tests(test)
            except OSError as error:
                raise MemoryFolderError(
                    f"{self._folder}: a test cannot be written: {error.strerror}"
                ) from error
            self._settled = None

    def forget_own_model(self) -> None:
        """Remove what the robot knows of itself; its next motions teach it again.

        Raises:
            MemoryFolderError: It cannot be removed.
        """
        with self._lock:
            self._forget_tests(_NOTHING)
            self._keep_records({})
            self._settled = None

    def learn_unexplained(self, unexplained: Mapping[str, Unexplained], spec: RobotSpec) -> None:
        """Store what a flight, known to `own_model` already, left unexplained, by the axes' names.

        Raises:
            MemoryFolderError: It cannot be stored.
        """
        with self._lock:
            if self._settled is not None:
                settled = with_unexplained(self._settled, unexplained, spec)
                self._keep_records(settled.records)
                self._settled = settled

    def _read_tests(self, *more: UnreadTest) -> None:
        """Learn from the tests that were kept, and from more; one that teaches nothing is named."""
        if not (more or len(self._unread)):
            return
        records = self._records
        for test in (*self._unread.tests(), *more):
            try:
                records = _with_new(records, *test.shown())
            except InvalidInputError as error:
                _log.warning("a test taught nothing: %s", error)
        self._keep_records(records)
        self._settled = None

    def _keep_records(self, records: Mapping[str, AxisRecord]) -> None:
        """Store what is known of each axis, with what all tests have shown that were kept."""
        data = _RECORDS.dump_json(dict(records))
        self._write(_OWN, data)
        self._records, self._own_sha256 = dict(records), digest(data)
        self._forget_tests(self._own_sha256)

    def _forget_tests(self, adds_to: str) -> None:
        try:
            self._unread.forget(adds_to)
        except OSError as error:
            raise MemoryFolderError(
                f"{self._folder}: tests cannot be removed: {error.strerror}"
            ) from error

    def _keep(self, name: str, kept: Kept) -> Kept:
        with self._lock:
            self._write(name, kept.payload)
            self._kept[name] = kept
        return kept

    def _write(self, name: str, data: bytes) -> None:
        """Replace a file as a whole: a crash leaves the old one or the new one."""
        if self._folder is None:
            return
        whole = self._folder / f"{name}{_SUFFIX}"
        try:
            write_privately(whole, bytes.fromhex(digest(data)) + data)
        except OSError as error:
            raise MemoryFolderError(f"{whole} cannot be written: {error.strerror}") from error

    def _read(self, folder: Path) -> None:
        for name in (*_ARCHITECTURES, *_PRIORS):
            path = folder / f"{name}{_SUFFIX}"
            payload = _stored(path, EXPERIENCE_BYTES_MAX, "then train or transfer again")
            if payload is not None:
                try:
                    self._kept[name] = _checked(payload, digest(payload))
                except MalformedMessageError as error:
                    raise MemoryFolderError(
                        f"{path} cannot be read: {error}; remove it, then train or transfer again"
                    ) from error
        path = folder / f"{_OWN}{_SUFFIX}"
        records = _stored(path, _OWN_BYTES_MAX, "the robot relearns it from its next motions")
        if records is not None:
            self._own_sha256 = digest(records)
            try:
                self._records = _RECORDS.validate_json(records)
            except ValidationError as error:
                raise MemoryFolderError(
                    f"{path} cannot be read: {describe_validation(error)}; remove it, the robot "
                    "relearns it from its next motions"
                ) from error


def _with_new(
    records: Mapping[str, AxisRecord],
    evidence: Mapping[str, Evidence],
    states: Mapping[str, StateEvidence],
    crosses: Mapping[str, Crosses],
) -> dict[str, AxisRecord]:
    """Return records after one more motion, with what it shows of each axis by the axis's name."""
    found = dict(records)
    for axis, new in evidence.items():
        before = found.get(axis, AxisRecord())
        found[axis] = before.with_new(new, states.get(axis), crosses.get(axis))
    return found


def _stored(path: Path, bytes_max: int, remedy: str) -> bytes | None:
    """Return the content of a file without its checksum; None if the file does not exist."""
    try:
        with path.open("rb") as file:
            stored = file.read(_SHA256_BYTES + bytes_max + 1)
    except FileNotFoundError:
        return None
    sha256, data = stored[:_SHA256_BYTES], stored[_SHA256_BYTES:]
    if sha256 != bytes.fromhex(digest(data)):
        raise MemoryFolderError(
            f"{path} is damaged: its content is not what was stored; remove it, {remedy}"
        )
    return data


def _checked(payload: bytes, sha256: str) -> Kept:
    experience: Experience = decode_experience(payload, sha256)
    return Kept(sha256, payload, experience.manifest, NetworkInverse(experience))
