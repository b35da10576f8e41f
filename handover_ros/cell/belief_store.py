"""The store of beliefs: one file a person, in a folder beside the profiles."""

from __future__ import annotations

import itertools
from pathlib import Path

from handover_ros.cell.store import StoreError, default_directory
from handover_ros.errors import HandoverError
from handover_ros.files import sync_folder
from handover_ros.preferences.belief_file import SUFFIX, PersonBelief, read_belief, write_belief
from handover_ros.skeleton.profile import safe_profile_id

FOLDER = "beliefs"
ASIDE = ".aside-"  # and a number: what was set aside before stays


class BeliefStore:
    """Beliefs in a folder, which is made when the first one is saved.

    Args:
        profiles: The folder of the profiles; default: ``store.default_directory``.
    """

    def __init__(self, profiles: Path | None = None) -> None:
        self.directory = (profiles or default_directory()) / FOLDER

    def path(self, profile_id: str) -> Path:
        """Return the file of a person.

        Raises:
            BadRequestError: The name is not safe.
        """
        return self.directory / f"{safe_profile_id(profile_id)}{SUFFIX}"

    def exists(self, profile_id: str) -> bool:
        """Return whether something is stored about a person."""
        return self.path(profile_id).exists()

    def load(self, profile_id: str) -> PersonBelief:
        """Return what is believed of a person.

        Raises:
            BadModelError: The file is damaged or of another person.
        """
        return read_belief(self.path(profile_id), profile_id)

    def save(self, person: PersonBelief) -> Path:
        """Write a belief whole or not at all and return its file.

        Raises:
            StoreError: The folder cannot be written to, or the disk is full; what was stored is as it was.
        """
        path = self.path(person.profile_id)
        try:
            write_belief(path, person)
        except OSError as error:
            raise StoreError(f"belief {path}: cannot be written: {error.strerror or error}; nothing changed") from None
        return path

    def set_aside(self, profile_id: str) -> Path | None:
        """Keep what is stored about a person under another name, and return that; None: nothing is stored.

        Raises:
            StoreError: The folder cannot be written to.
        """
        path = self.path(profile_id)
        if not path.exists():
            return None
        aside = next(
            each for n in itertools.count(1) if not (each := path.with_name(f"{path.name}{ASIDE}{n}")).exists()
        )
        try:
            path.replace(aside)
            sync_folder(self.directory)
        except OSError as error:
            raise StoreError(f"belief {path}: cannot be renamed: {error.strerror or error}") from None
        return aside

    def others(self, profile_id: str) -> tuple[PersonBelief, ...]:
        """Return what is believed of all other people; damaged files are passed over."""
        found = []
        for path in sorted(self.directory.glob(f"*{SUFFIX}")) if self.directory.exists() else []:
            if path.stem == profile_id:
                continue
            try:
                found.append(read_belief(path, path.stem))
            except HandoverError:
                continue
        return tuple(found)
