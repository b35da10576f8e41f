"""The store: whole or not at all, whatever happens while it is written."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest
from profiles import profile_of

from handover_ros.cell.store import ProfileStore, StoreError, default_directory
from handover_ros.errors import BadModelError, BadRequestError, ErrorCode, UnknownNameError
from handover_ros.skeleton.profile import profile_to_json

HERE = Path(__file__).resolve().parent


@pytest.fixture
def store(tmp_path: Path) -> ProfileStore:
    return ProfileStore(tmp_path / "profiles")


def test_an_empty_store_makes_no_folder_and_lists_nothing(store: ProfileStore):
    assert store.list() == ()
    assert store.active() is None
    assert not store.directory.exists()


def test_saved_listed_loaded_replaced_deleted(store: ProfileStore):
    store.save(profile_of("anna"))
    store.save(profile_of("bert", seed=2))
    assert store.names() == ("anna", "bert")
    store.save(profile_of("anna", seed=3, person="Anna again"))
    assert store.load("anna").person == "Anna again"
    store.delete("bert")
    assert [stored.profile_id for stored in store.list()] == ["anna"]
    with pytest.raises(UnknownNameError, match="anna"):
        store.load("bert")
    assert [path.name for path in store.directory.iterdir()] == ["anna.json"]


def test_a_deleted_active_profile_is_not_active_even_when_it_comes_back(store: ProfileStore):
    store.save(profile_of("anna"))
    assert store.active() is None
    store.activate("anna")
    assert store.active().profile_id == "anna"
    assert ProfileStore(store.directory).active_id() == "anna", "it is remembered"
    assert [stored.active for stored in store.list()] == [True]
    store.delete("anna")
    assert store.active() is None
    store.save(profile_of("anna"))
    assert store.active_id() == ""


def test_an_active_profile_whose_file_somebody_removed_is_not_active(store: ProfileStore):
    store.save(profile_of("anna"))
    store.activate("anna")
    (store.directory / "anna.json").unlink()
    assert store.active() is None
    store.deactivate()
    store.deactivate()


@pytest.mark.parametrize("content", [b"", b"../../etc/passwd", b"\xff\xfe", b"x" * 100_000, b"nobody"])
def test_a_damaged_active_file_means_none(store: ProfileStore, content):
    store.save(profile_of("anna"))
    (store.directory / "active").write_bytes(content)
    assert store.active_id() == ""
    assert store.active() is None


def test_a_damaged_file_is_listed_with_its_reason_and_hides_no_other(store: ProfileStore):
    for name in ("anna", "bert", "carl", "dora"):
        store.save(profile_of(name))
    (store.directory / "bert.json").write_text(profile_to_json(profile_of("bert"))[:5000])
    (store.directory / "carl.json").write_text(profile_to_json(profile_of("anna")))
    (store.directory / "two words.json").write_text("{}")
    (store.directory / "folder.json").mkdir()
    (store.directory / "notes.txt").write_text("no profile")
    listed = {stored.profile_id: stored for stored in store.list()}
    assert set(listed) == {"anna", "bert", "carl", "dora", "folder", "two words"}
    assert [name for name, stored in listed.items() if stored.profile] == ["anna", "dora"]
    assert "JSON" in listed["bert"].problem
    assert "another name" in listed["carl"].problem
    assert listed["two words"].problem
    for name in ("bert", "carl"):
        with pytest.raises(BadModelError):
            store.activate(name)
        store.delete(name)
    assert store.active_id() == ""


@pytest.mark.parametrize("name", ["../anna", "", "a/b", "anna.json", "a" * 65, "anna\0"])
@pytest.mark.parametrize("method", ["load", "delete", "activate"])
def test_names_that_could_be_paths_are_refused(store: ProfileStore, method, name):
    with pytest.raises(BadRequestError):
        getattr(store, method)(name)


CRASH = textwrap.dedent(
    """
    import os, signal, sys
    from pathlib import Path
    sys.path[:0] = sys.argv[2:]
    from profiles import profile_of
    from handover_ros.cell.store import ProfileStore
    when, store = sys.argv[1].split(":", 1)
    die = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
    if when == "fsync":
        os.fsync = die
    elif when == "rename":
        Path.replace = die
    ProfileStore(Path(store)).save(profile_of("anna", seed=9, person="new"))
    """
)


@pytest.mark.parametrize("when", ["fsync", "rename"])
def test_a_crash_in_the_middle_of_writing_leaves_the_old_profile(store: ProfileStore, when):
    store.save(profile_of("anna", person="old"))
    folders = [str(HERE.parents[1]), str(HERE), str(HERE.parent / "skeleton")]
    command = [sys.executable, "-c", CRASH, f"{when}:{store.directory}", *folders]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert [stored.profile.person for stored in store.list()] == ["old"]
    orphans = [path for path in store.directory.iterdir() if path.name.startswith(".")]
    assert len(orphans) == 1, "the crash left its temporary file"
    os.utime(orphans[0], (0, 0))
    store.save(profile_of("anna", person="newer"))
    assert [path.name for path in store.directory.iterdir()] == ["anna.json"], "which the next save removes"


def test_many_writers_and_readers_at_once_see_whole_profiles_only(store: ProfileStore):
    people = [f"person {number}" for number in range(4)]
    texts = [profile_of("anna", seed=number, person=person) for number, person in enumerate(people)]
    store.save(texts[0])
    problems: list[str] = []
    stop = threading.Event()

    def write(profile) -> None:
        try:
            for _ in range(15):
                store.save(profile)
                store.activate("anna")
        except Exception as error:
            problems.append(repr(error))

    def read() -> None:
        while not stop.is_set():
            for stored in store.list():
                if stored.profile is None or stored.profile.person not in people:
                    problems.append(stored.problem)

    reader = threading.Thread(target=read)
    writers = [threading.Thread(target=write, args=(profile,)) for profile in texts]
    for thread in (reader, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    stop.set()
    reader.join()
    assert problems == []
    assert sorted(path.name for path in store.directory.iterdir()) == ["active", "anna.json"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_a_full_or_broken_disk_is_answered_with_a_remedy_and_nothing_is_lost(store: ProfileStore, monkeypatch, number):
    store.save(profile_of("anna", person="old"))
    store.activate("anna")

    def fail(_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    for action in (lambda: store.save(profile_of("anna", person="new")), lambda: store.activate("anna")):
        with pytest.raises(StoreError) as caught:
            action()
        assert caught.value.code is ErrorCode.STORE_FAILED
        assert os.strerror(number) in str(caught.value)
        assert "HANDOVER_PROFILES" in str(caught.value)
    monkeypatch.undo()
    assert store.active().person == "old"
    assert sorted(path.name for path in store.directory.iterdir()) == ["active", "anna.json"]


def test_a_folder_that_cannot_be_made_or_written_is_named(tmp_path: Path):
    (tmp_path / "file").write_text("")
    store = ProfileStore(tmp_path / "file" / "profiles")
    assert store.list() == ()
    with pytest.raises(StoreError, match="profiles"):
        store.save(profile_of("anna"))
    with pytest.raises(StoreError, match="profiles"):
        ProfileStore(Path("/proc/profiles")).save(profile_of("anna"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_named(store: ProfileStore):
    store.save(profile_of("anna"))
    store.directory.chmod(0o500)
    try:
        for action in (lambda: store.save(profile_of("bert")), lambda: store.delete("anna")):
            with pytest.raises(StoreError, match="rights"):
                action()
        assert store.load("anna")
    finally:
        store.directory.chmod(0o700)


def test_the_default_folder_follows_the_environment(monkeypatch, tmp_path: Path):
    monkeypatch.setenv("HANDOVER_PROFILES", str(tmp_path / "own"))
    assert default_directory() == tmp_path / "own"
    monkeypatch.delenv("HANDOVER_PROFILES")
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_directory() == tmp_path / ".local" / "share" / "handover_ros" / "profiles"
