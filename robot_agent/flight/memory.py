"""What a robot keeps of what was learned: its experiences, the prior it was given, its baseline.

In a folder of its own, so that it survives the agent's restart; every file is replaced as a whole
and begins with the sha256 of what follows, so that no damage goes unnoticed.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from nufleet.robot_agent.flight.baseline_model import BaselineModel
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.shared.errors import MalformedMessageError, NufleetError
from nufleet.shared.experience.file import (
    EXPERIENCE_BYTES_MAX,
    Experience,
    decode_experience,
    digest,
)
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.private_files import make_private_folder, synchronise_folder, write_privately
from nufleet.shared.strict import Name, describe_validation

PRIOR = "prior"
_BASELINE = "baseline"
_SUFFIX = ".learned"
_SHA256_BYTES = 32
_BASELINE_BYTES_MAX = 64 * 2**20
_ARCHITECTURES: tuple[Architecture, ...] = ("state", "preview")
_BASELINE_MODELS: TypeAdapter[dict[Name, BaselineModel]] = TypeAdapter(dict[Name, BaselineModel])


class MemoryFolderError(NufleetError):
    """What a robot learned cannot be stored, or what is stored is not what was stored."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A stored experience: its file, and the model in it."""

    sha256: str
    payload: bytes
    manifest: ExperienceManifest
    inverse: NetworkInverse


class Memory:
    """One robot's memory; usable from many threads.

    The robot offers one experience of its own for each architecture, and flies with one prior.
    """

    def __init__(self, folder: Path | None) -> None:
        """Read what is there; without a folder nothing survives the process.

        Raises:
            MemoryFolderError: a file is damaged, or the folder cannot be made.
        """
        self._folder = folder
        self._lock = threading.Lock()
        self._kept: dict[str, Kept] = {}
        self._baseline: Mapping[str, BaselineModel] = {}
        if folder is not None:
            try:
                make_private_folder(folder)
                self._read(folder)
            except OSError as error:
                raise MemoryFolderError(f"{folder}: {error.strerror}; see to the disk") from error

    @property
    def experiences(self) -> tuple[Kept, ...]:
        """The robot's own experiences."""
        with self._lock:
            return tuple(self._kept[name] for name in _ARCHITECTURES if name in self._kept)

    @property
    def prior(self) -> Kept | None:
        """The experience that was transferred to the robot."""
        with self._lock:
            return self._kept.get(PRIOR)

    @property
    def baseline(self) -> Mapping[str, BaselineModel]:
        """What the baseline of each axis does, by the axis's name; empty before it was flown."""
        with self._lock:
            return self._baseline

    def find(self, sha256: str) -> Kept | None:
        """Return the experience or prior with that digest."""
        with self._lock:
            return next((kept for kept in self._kept.values() if kept.sha256 == sha256), None)

    def keep_experience(self, payload: bytes, sha256: str) -> Kept:
        """Store an experience of the robot's own, in the place of the one of its architecture.

        Raises:
            MalformedMessageError: it is not an experience with that digest.
            MemoryFolderError: it cannot be stored.
        """
        kept = _checked(payload, sha256)
        return self._keep(kept.manifest.layout.architecture, kept)

    def keep_prior(self, payload: bytes, sha256: str) -> Kept:
        """Store the prior that the robot flies with; raises as `keep_experience` does."""
        return self._keep(PRIOR, _checked(payload, sha256))

    def forget_prior(self) -> None:
        """Fly without a prior from now on."""
        with self._lock:
            if self._folder is not None:
                try:
                    (self._folder / f"{PRIOR}{_SUFFIX}").unlink(missing_ok=True)
                    synchronise_folder(self._folder)
                except OSError as error:
                    raise MemoryFolderError(
                        f"{self._folder}: the prior cannot be removed: {error.strerror}"
                    ) from error
            self._kept.pop(PRIOR, None)

    def keep_baseline(self, models: Mapping[str, BaselineModel]) -> None:
        """Store what the baseline of each axis does."""
        with self._lock:
            self._write(_BASELINE, _BASELINE_MODELS.dump_json(dict(models)))
            self._baseline = dict(models)

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
        for name in (*_ARCHITECTURES, PRIOR):
            path = folder / f"{name}{_SUFFIX}"
            payload = _stored(path, EXPERIENCE_BYTES_MAX, "then train or transfer anew")
            if payload is not None:
                try:
                    self._kept[name] = _checked(payload, digest(payload))
                except MalformedMessageError as error:
                    raise MemoryFolderError(
                        f"{path} cannot be read: {error}; remove it, then train or transfer anew"
                    ) from error
        path = folder / f"{_BASELINE}{_SUFFIX}"
        models = _stored(path, _BASELINE_BYTES_MAX, "the robot learns it anew from a rich flight")
        if models is not None:
            try:
                self._baseline = _BASELINE_MODELS.validate_json(models)
            except ValidationError as error:
                raise MemoryFolderError(
                    f"{path} cannot be read: {describe_validation(error)}; remove it, the robot "
                    "learns it anew from a rich flight"
                ) from error


def _stored(path: Path, bytes_max: int, remedy: str) -> bytes | None:
    """Return what a file was written with; None if it is not there."""
    try:
        with path.open("rb") as file:
            stored = file.read(_SHA256_BYTES + bytes_max + 1)
    except FileNotFoundError:
        return None
    sha256, data = stored[:_SHA256_BYTES], stored[_SHA256_BYTES:]
    if sha256 != bytes.fromhex(digest(data)):
        raise MemoryFolderError(
            f"{path} is damaged: it is not what was stored there; remove it, {remedy}"
        )
    return data


def _checked(payload: bytes, sha256: str) -> Kept:
    experience: Experience = decode_experience(payload, sha256)
    return Kept(sha256, payload, experience.manifest, NetworkInverse(experience))
