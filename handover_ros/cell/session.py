"""One folder a session: what ran, with which parameters and versions, whom it knew before and after, and the bag."""

from __future__ import annotations

import json
import math
import platform
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import yaml

from handover_ros.bags.reading import BAG, METADATA, Bag
from handover_ros.bags.rescue import rescue
from handover_ros.cell.belief_store import FOLDER as BELIEFS
from handover_ros.cell.processes import NodeLaunch
from handover_ros.cell.store import ACTIVE_FILE, SUFFIX
from handover_ros.errors import BadRequestError, HandoverError
from handover_ros.files import write_whole
from handover_ros.provenance import commit, versions

FORMAT = 1
FILE = "session.json"
PARAMETERS = "parameters"
START, END = "start", "end"
ACTIVE_PROFILE = "/calibration/active_profile"
RUNNING, OK, FAILED, INTERRUPTED = "running", "ok", "failed", "interrupted"


@dataclass
class Session:
    """A session's folder while it runs; written at its beginning and again at its end.

    Attributes:
        folder: Where everything is.
        command: ``demo`` or ``up``.
        arguments: What it was asked for.
        launches: How each node was started.
        profiles: Folder of the people's profiles and beliefs.
        began: When.
    """

    folder: Path
    command: str
    arguments: Mapping[str, Any]
    launches: Sequence[NodeLaunch]
    profiles: Path
    began: datetime

    @staticmethod
    def begin(
        folder: Path, command: str, arguments: Mapping[str, Any], launches: Sequence[NodeLaunch], profiles: Path
    ) -> Session:
        """Write what is known at the beginning.

        Raises:
            BadRequestError: The folder holds a session already.
        """
        if (folder / FILE).exists() or (folder / BAG).exists():
            raise BadRequestError(f"--out {folder}: holds a session already; name another folder")
        session = Session(folder, command, arguments, launches, profiles, datetime.now(timezone.utc))
        for launch in launches:
            content = {launch.node: {"ros__parameters": parameters_of(launch)}}
            write_whole(folder / PARAMETERS / f"{launch.node}.yaml", yaml.safe_dump(content, sort_keys=False))
        copy_people(profiles, folder / START)
        session._write(RUNNING, {})
        return session

    def end(self, outcome: str, metrics: Mapping[str, float]) -> None:
        """Write what is known at the end; a bag that was not closed is made whole."""
        mend_bag(self.folder / BAG)
        copy_people(self.profiles, self.folder / END)
        active = people_in(self.folder / BAG)
        if active is not None:  # whoever was not there has no place in it
            for part in (START, END):
                keep_people(self.folder / part, active)
        self._write(outcome, metrics)

    def _write(self, outcome: str, metrics: Mapping[str, float]) -> None:
        document = {
            "format": FORMAT,
            "command": self.command,
            "arguments": {key: plain(value) for key, value in self.arguments.items()},
            "began": self.began.isoformat(timespec="seconds"),
            "ended": None if outcome == RUNNING else datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "outcome": outcome,
            "versions": versions(),
            "commit": commit(),
            "host": platform.node(),
            "nodes": {launch.node: {key: plain(v) for key, v in launch.parameters.items()} for launch in self.launches},
            "metrics": {key: plain(value) for key, value in metrics.items()},
        }
        write_whole(self.folder / FILE, json.dumps(document, indent=2, allow_nan=False) + "\n")


def plain(value: Any) -> Any:
    """Return a value as JSON has it; what is not finite becomes null, what JSON does not know its text."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    return str(value)


def parameters_of(launch: NodeLaunch) -> dict[str, Any]:
    """Return the parameters a node is started with: of its file, then its own."""
    given: dict[str, Any] = {}
    if launch.parameter_file is not None and launch.parameter_file.is_file():
        content = yaml.safe_load(launch.parameter_file.read_text(encoding="utf-8")) or {}
        given = dict((content.get(launch.node) or {}).get("ros__parameters") or {})
    return {**given, **launch.parameters}


def copy_people(profiles: Path, target: Path) -> None:
    """Copy profiles, beliefs and who is active; the target exists afterwards, be it empty."""
    (target / BELIEFS).mkdir(parents=True, exist_ok=True)
    for file in (*profiles.glob(f"*{SUFFIX}"), profiles / ACTIVE_FILE, *(profiles / BELIEFS).glob("*.npz")):
        if file.is_file() and not file.name.startswith("."):
            shutil.copy2(file, target / file.relative_to(profiles))


def keep_people(folder: Path, names: Collection[str]) -> None:
    """Remove from a copy whoever is not named."""
    for file in (*folder.glob(f"*{SUFFIX}"), *(folder / BELIEFS).glob("*.npz")):
        if file.stem not in names:
            file.unlink()


def people_in(bag: Path) -> set[str] | None:
    """Return whose profile was active while a bag was recorded; None: that cannot be told."""
    try:
        with Bag(bag) as opened:
            if ACTIVE_PROFILE not in opened.topics:
                return None
            return {opened.decode(topic, data).info.profile_id for topic, _, data in opened.read([ACTIVE_PROFILE])}
    except HandoverError:
        return None


def mend_bag(bag: Path) -> None:
    """Make a whole bag of one that was not closed, if anything of it can be read."""
    if not bag.is_dir() or (bag / METADATA).is_file():
        return
    whole = bag.with_name(f"{bag.name}_whole")
    shutil.rmtree(whole, ignore_errors=True)
    try:
        rescue(bag, whole)
    except HandoverError:
        return
    # The storage file has the folder's name.
    shutil.rmtree(bag)
    shutil.move(whole, bag)
