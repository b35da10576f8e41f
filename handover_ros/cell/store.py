"""The store of profiles: one file a person, and which of them is active; each written whole or not at all."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from handover_ros.errors import BadModelError, BadRequestError, ErrorCode, HandoverError, UnknownNameError
from handover_ros.files import sync_folder, write_whole
from handover_ros.skeleton.profile import MAX_BYTES, Profile, profile_to_json, read_profile, safe_profile_id

SUFFIX = ".json"
ACTIVE_FILE = "active"  # holds the name of the active profile; has no suffix, so it is no profile itself
ORPHAN_AGE = 3600.0  # [s] after which a temporary file is one that a crash left behind


class StoreError(HandoverError):
    """The store cannot be written or read."""

    code = ErrorCode.STORE_FAILED


@dataclass(frozen=True, eq=False)
class StoredProfile:
    """One file of the store.

    Attributes:
        profile_id: Its name.
        active: Whether it is the active profile.
        profile: Its content; None when it is damaged.
        problem: Why it cannot be used; empty when it can.
    """

    profile_id: str
    active: bool
    profile: Profile | None
    problem: str = ""


def default_directory() -> Path:
    """Return ``$HANDOVER_PROFILES``, or ``handover_ros/profiles`` in the user's data folder."""
    if own := os.environ.get("HANDOVER_PROFILES"):
        return Path(own).expanduser()
    base = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(base) / "handover_ros" / "profiles"


class ProfileStore:
    """Profiles in a folder, which is made when the first one is saved.

    Several processes may use one folder: each file is replaced at once, and the last writer wins.

    Args:
        directory: The folder; default: :func:`default_directory`.
    """

    def __init__(self, directory: Path | None = None) -> None:
        self.directory = directory or default_directory()

    def names(self) -> tuple[str, ...]:
        """Return the names of all profiles, damaged ones too, sorted.

        Raises:
            StoreError: The folder cannot be read.
        """
        try:
            if not self.directory.exists():
                return ()
            found = [path for path in self.directory.iterdir() if path.suffix == SUFFIX and path.name[0] != "."]
        except OSError as error:
            raise self._failure("read", error) from None
        return tuple(sorted(path.stem for path in found))

    def list(self) -> tuple[StoredProfile, ...]:
        """Return all profiles; a damaged one comes with the reason and does not hide the others.

        Raises:
            StoreError: The folder cannot be read.
        """
        active = self.active_id()
        stored = []
        for name in self.names():
            try:
                stored.append(StoredProfile(name, name == active, self.load(name)))
            except HandoverError as error:
                stored.append(StoredProfile(name, False, None, str(error)))
        return tuple(stored)

    def load(self, profile_id: str) -> Profile:
        """Return a profile.

        Raises:
            BadRequestError: The name is not safe.
            UnknownNameError: There is none of that name.
            BadModelError: Its file is damaged; names file and field.
        """
        path = self._existing(profile_id)
        profile = read_profile(path)
        if profile.profile_id != profile_id:
            raise BadModelError(f"{path}: profile_id: is {profile.profile_id!r}, but the file has another name")
        return profile

    def save(self, profile: Profile) -> Path:
        """Write a profile whole or not at all and return its file; one of the same name is replaced.

        Raises:
            StoreError: The folder cannot be written to, or the disk is full; what was stored is as it was.
        """
        path, text = self._path(profile.profile_id), profile_to_json(profile)
        if len(text) > MAX_BYTES:
            raise StoreError(f"profile {profile.profile_id}: {len(text)} bytes, a profile has at most {MAX_BYTES}")
        self._write(path, text)
        self._remove_orphans()
        return path

    def delete(self, profile_id: str) -> None:
        """Delete a profile, damaged or not; the active one is deactivated.

        Raises:
            BadRequestError: The name is not safe.
            UnknownNameError: There is none of that name.
            StoreError: It cannot be deleted.
        """
        path = self._existing(profile_id)
        was_active = self._noted_id() == profile_id
        try:
            path.unlink(missing_ok=True)
            sync_folder(self.directory)
        except OSError as error:
            raise self._failure("written to", error) from None
        if was_active:
            self.deactivate()

    def activate(self, profile_id: str) -> Profile:
        """Make a profile the active one and return it.

        Raises:
            BadRequestError: The name is not safe.
            UnknownNameError: There is none of that name.
            BadModelError: Its file is damaged.
            StoreError: The folder cannot be written to.
        """
        profile = self.load(profile_id)
        self._write(self.directory / ACTIVE_FILE, profile_id + "\n")
        return profile

    def deactivate(self) -> None:
        """Make no profile the active one.

        Raises:
            StoreError: The folder cannot be written to.
        """
        try:
            (self.directory / ACTIVE_FILE).unlink(missing_ok=True)
        except OSError as error:
            raise self._failure("written to", error) from None

    def active_id(self) -> str:
        """Return the name of the active profile; empty when none is, or when its file is gone."""
        noted = self._noted_id()
        return noted if noted and self._path(noted).is_file() else ""

    def active(self) -> Profile | None:
        """Return the active profile, None when none is.

        Raises:
            BadModelError: Its file is damaged.
        """
        active = self.active_id()
        return self.load(active) if active else None

    def _noted_id(self) -> str:
        """Return the name in the active file; empty when there is none that can be used."""
        try:
            with (self.directory / ACTIVE_FILE).open("rb") as file:
                return safe_profile_id(file.read(200).decode("ascii").strip())
        except (OSError, UnicodeDecodeError, BadRequestError):
            return ""

    def _path(self, profile_id: str) -> Path:
        return self.directory / f"{safe_profile_id(profile_id)}{SUFFIX}"

    def _existing(self, profile_id: str) -> Path:
        path = self._path(profile_id)
        if not path.is_file():
            raise UnknownNameError("profile", profile_id, self.names())
        return path

    def _write(self, path: Path, text: str) -> None:
        try:
            write_whole(path, text)
        except OSError as error:
            raise self._failure("written to", error) from None

    def _failure(self, verb: str, error: OSError) -> StoreError:
        return StoreError(
            f"profiles folder {self.directory} cannot be {verb}: {error.strerror or error}; nothing was changed; "
            "free space or give the folder's rights to this user, or set HANDOVER_PROFILES to another folder"
        )

    def _remove_orphans(self) -> None:
        """Remove temporary files that a crash left behind long ago."""
        for path in self.directory.glob(".*"):
            try:
                if path.is_file() and time.time() - path.stat().st_mtime > ORPHAN_AGE:
                    path.unlink()
            except OSError:
                continue
