"""Beliefs as files: whole, checked, and the same again."""

import json

import numpy as np
import pytest
from planar_people import answer_of, neutral_space, random_query, whole_space

from handover_ros.errors import BadModelError
from handover_ros.preferences import belief as belief_module
from handover_ros.preferences.belief import first_belief
from handover_ros.preferences.belief_file import PersonBelief, read_belief, write_belief
from handover_ros.preferences.prior import Normal, Prior
from handover_ros.preferences.query import chosen


def person(answers=3, population=None, space=None, particles=200):
    space = space or whole_space()
    rng = np.random.default_rng(0)
    belief = first_belief(Prior(space, population), particles, 0.95, seed=4)
    truth = space.people(belief.particles[:1])
    for _ in range(answers):
        query = random_query(rng)
        belief = belief.updated(query, chosen(answer_of(truth, query, rng)))
    return PersonBelief("anna", belief, tuple(f"h{n}" for n in range(answers)), (0.5,) * answers)


@pytest.mark.parametrize(
    "stored",
    [
        person(),
        person(0),
        person(2, Normal(np.array([0.5, 1.0]), np.eye(2)), neutral_space()),
    ],
    ids=["answers", "none", "population"],
)
def test_what_is_read_is_what_was_written(tmp_path, stored):
    path = tmp_path / "anna.npz"
    write_belief(path, stored)
    again = read_belief(path, "anna")
    assert (again.profile_id, again.handover_ids, again.surprises) == (
        stored.profile_id,
        stored.handover_ids,
        stored.surprises,
    )
    for name in ("particles", "log_weights", "fit", "mean", "mode"):
        np.testing.assert_array_equal(getattr(again.belief, name), getattr(stored.belief, name))
    for name in ("log_evidence", "entropy", "observations", "retention", "seed"):
        assert getattr(again.belief, name) == getattr(stored.belief, name)
    query = random_query(np.random.default_rng(9))
    after, expected = again.belief.updated(query, chosen(0)), stored.belief.updated(query, chosen(0))
    np.testing.assert_array_equal(after.particles, expected.particles)


def test_a_belief_that_stands_for_its_answers_is_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(belief_module, "MOST_REMEMBERED", 2)
    stored = person(4)
    assert stored.belief.summary is not None
    write_belief(tmp_path / "anna.npz", stored)
    again = read_belief(tmp_path / "anna.npz", "anna")
    np.testing.assert_array_equal(again.belief.summary.posterior.mean, stored.belief.summary.posterior.mean)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_file_cut_short_is_said(tmp_path, share):
    path = tmp_path / "anna.npz"
    write_belief(path, person())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(BadModelError, match="cut short"):
        read_belief(path, "anna")


def test_every_flipped_byte_is_noticed_or_harmless(tmp_path):
    """Never another exception, never numbers that are not finite."""
    path = tmp_path / "anna.npz"
    write_belief(path, person(1, particles=20))
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for place in rng.integers(len(content), size=200):
        broken = bytearray(content)
        broken[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(broken))
        try:
            read = read_belief(path, "anna")
        except BadModelError:
            continue
        assert np.isfinite(read.belief.particles).all()


def test_another_person_s_file_is_refused(tmp_path):
    write_belief(tmp_path / "bert.npz", person())
    with pytest.raises(BadModelError, match="about 'anna', not about 'bert'"):
        read_belief(tmp_path / "bert.npz", "bert")


def changed(path, name, value):
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays[name] = value(arrays[name])
    np.savez(path, **arrays)


def header_with(**more):
    return lambda header: np.array(json.dumps({**json.loads(str(header)), **more}))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("header", header_with(version=2), "version: is 2"),
        ("header", header_with(colour="blue"), "colour"),
        ("header", header_with(retention=0.0), "out of range"),
        ("particles", lambda a: a * np.nan, "particles: needs finite"),
        ("particles", lambda a: a[:, :1], "particles: needs finite numbers of shape"),
        ("log_weights", lambda a: a[:-1], "log_weights: needs"),
        ("log_weights", lambda a: a + 1.0, "sum to"),
        ("configurations_0", lambda a: a * np.inf, "must be finite"),
        ("places_0", lambda a: a + 10_000, "do not fit"),
        ("weight_bounds", lambda a: -a, "weight_bounds"),
    ],
)
def test_numbers_that_do_not_fit_are_named(tmp_path, name, value, message):
    path = tmp_path / "anna.npz"
    write_belief(path, person())
    changed(path, name, value)
    with pytest.raises(BadModelError, match=message):
        read_belief(path, "anna")


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(BadModelError, match="cannot be read"):
        read_belief(tmp_path / "nobody.npz", "nobody")
