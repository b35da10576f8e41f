"""The study as a whole: same numbers for any number of processes, resumable, and claims that follow the data."""

import csv
import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from matplotlib import image
from rich.console import Console
from small_study import small_settings, small_study

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.studies import chapter4, registry, units
from handover_ros.studies.arm_courses import offering
from handover_ros.studies.chapter4_claims import claims
from handover_ros.studies.chapter4_settings import Chapter4Settings, load_chapter4_settings
from handover_ros.studies.chapter4_study import CHAPTER4
from handover_ros.studies.study import Figure
from handover_ros.studies.study_command import StudyRequest, run_study
from handover_ros.studies.tables import csv_of, merged
from handover_ros.yaml_file import read_yaml

OBJECTS = ("handlebars", "u_lock")
QUIET = Console(quiet=True)


def run(monkeypatch, folder, jobs, **changes):
    """Run the small study and return its CSV files by name."""
    monkeypatch.setitem(registry.STUDIES, "chapter4", small_study(**changes))
    assert run_study(StudyRequest("chapter4", jobs=jobs, seed=3, json_file=folder / "out.json", out=folder), QUIET) == 0
    return {path.name: path.read_bytes() for path in folder.glob("*.csv")}


@lru_cache(maxsize=1)
def small_tables():
    settings = small_settings()
    return merged(chapter4.work(settings, unit, 3) for unit in chapter4.units(settings))


def test_numbers_do_not_depend_on_jobs_or_interruptions(monkeypatch, tmp_path):
    alone = run(monkeypatch, tmp_path / "one", 1)
    assert set(alone) == {"chapter4_learning.csv", "chapter4_feasible_sets.csv", "chapter4_likelihoods.csv"}
    assert run(monkeypatch, tmp_path / "two", 2) == alone
    # Stopped half way, one finished part damaged by whatever stopped it.
    settings, folder = small_settings(), tmp_path / "stopped"
    store = units.unit_store(folder, "chapter4", settings, 3)
    every = chapter4.units(settings)

    def stop(done, count):
        if done >= count // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        units.work_on(every, chapter4.work, settings, 3, store, 1, stop)
    kept = sorted(store.folder.glob("*.json"))
    assert 0 < len(kept) < len(every)
    kept[0].write_text(kept[0].read_text()[:50])
    times = {path: path.stat().st_mtime_ns for path in kept[1:]}
    assert run(monkeypatch, folder, 1) == alone
    assert {path: path.stat().st_mtime_ns for path in times} == times


def test_another_seed_or_setting_takes_nothing_from_what_is_kept(tmp_path):
    folders = {
        units.unit_store(tmp_path, "chapter4", settings, seed).folder
        for settings, seed in ((small_settings(), 1), (small_settings(), 2), (small_settings(rationality=5.0), 1))
    }
    assert len(folders) == 3


def test_json_has_the_stable_shape_and_every_claim_a_verdict(monkeypatch, tmp_path):
    run(monkeypatch, tmp_path, 1)
    document = json.loads((tmp_path / "out.json").read_text())
    assert document["command"] == "study"
    assert document["ok"] is True
    assert document["metrics"]["parts"] == len(chapter4.units(small_settings()))
    ids = [claim["id"] for claim in document["claims"]]
    assert len(set(ids)) == len(ids)
    for claim in document["claims"]:
        assert {"id", "chapter", "text", "dissertation", "ours", "verdict"} <= set(claim)
        assert claim["verdict"] in ("reproduced", "not reproduced", "needs people")
        assert (claim["verdict"] == "needs people") == (not claim["tests"])
    report = (tmp_path / "report.md").read_text()
    assert all(claim["text"] in report for claim in document["claims"])
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["settings"]["rationality"] == small_settings().rationality


def test_all_studies_make_one_page_that_needs_no_other_file(monkeypatch, tmp_path):
    study = small_study(people=1)
    drawing = replace(study, figures=lambda given, tables, seed, folder: [drawn(folder)])
    for name in [*registry.STUDIES]:
        monkeypatch.delitem(registry.STUDIES, name)
    monkeypatch.setitem(registry.STUDIES, "first", replace(drawing, name="first", title="The first"))
    monkeypatch.setitem(registry.STUDIES, "second", replace(drawing, name="second", title="The second"))
    out = tmp_path / "all"
    assert run_study(StudyRequest("all", seed=3, json_file=tmp_path / "all.json", out=out), QUIET) == 0
    page = (out / "report.html").read_text()
    assert page.count("<h1>") == 2
    assert page.count("data:image/png;base64,") == 2
    assert 'src="f' not in page
    assert "http" not in page
    document = json.loads((tmp_path / "all.json").read_text())
    assert page.count("<tr>") == len(document["claims"]) + 2
    assert {"first_parts", "second_parts", "seconds"} <= set(document["metrics"])
    assert (out / "first" / "summary.json").is_file()
    assert (out / "second" / "second_learning.csv").is_file()


def drawn(folder):
    """Return a figure that is one small picture."""
    image.imsave(folder / "figure.png", np.zeros((4, 4)))
    return Figure("1", "a caption", (folder / "figure.png",))


def test_csv_holds_every_person_strategy_and_iteration(monkeypatch, tmp_path):
    run(monkeypatch, tmp_path, 1)
    settings = small_settings()
    with (tmp_path / "chapter4_learning.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["scenario"] == "planar_weights"]
    assert len(rows) == settings.people * len(settings.strategies) * (settings.planar.queries + 1)
    assert all(float(row["log_density"]) == pytest.approx(float(row["log_density"])) for row in rows)


# Claims follow the data.


def verdicts(tables):
    return {claim.name: claim.verdict for claim in claims(tables, OBJECTS)}


def changed(change):
    """Return the tables with every row of learning changed."""
    tables = dict(small_tables())
    tables["learning"] = [{**row, **change(row)} for row in tables["learning"]]
    return tables


def test_whoever_is_better_decides_the_verdict():
    """Measures that depend on the strategy alone, with a little scatter between persons."""
    rank = {"active": 3.0, "passive": 2.0, "random": 1.0}

    def measures(sign):
        def change(row):
            better = sign * rank.get(row["strategy"], 0.0) + 0.01 * np.sin(
                row["person"] + 10.0 * rank.get(row["strategy"], 0.0)
            )
            return {"log_density": better, "distance": -better, "test_log_likelihood": better}

        return change

    for sign, expected in ((1.0, "reproduced"), (-1.0, "not reproduced")):
        found = verdicts(changed(measures(sign)))
        for scenario in chapter4.LEARNING:
            for measure in ("log_density", "distance", "test_log_likelihood"):
                assert found[f"{scenario}_{measure}"] == expected
        assert found["users_early"] == expected


def test_objects_that_are_chosen_decide_the_verdict():
    def change(row):
        if row["iteration"] == 0:
            return {}
        return {"object": "handlebars" if row["strategy"] == "active" else "u_lock"}

    found = verdicts(changed(change))
    assert found["user_study_objects"] == found["arm_neutral_objects"] == "reproduced"
    swapped = verdicts(changed(lambda row: {"object": "u_lock"} if row["iteration"] else {}))
    assert swapped["user_study_objects"] == "not reproduced"


def test_from_people_who_choose_by_chance_nothing_is_learned():
    """With almost no rationality there is no information to be had, and active cannot win."""
    settings = small_settings(rationality=1e-4, people=4)
    chosen = [unit for unit in chapter4.units(settings) if unit.scenario.startswith("planar")]
    tables = dict(small_tables())
    taught = merged(chapter4.work(settings, unit, 3) for unit in chosen)["learning"]
    others = [row for row in tables["learning"] if not row["scenario"].startswith("planar")]
    tables["learning"] = taught + others
    assert max(row["information"] for row in taught if row["iteration"]) < 1e-4
    found = verdicts(tables)
    for learned in ("neutral", "weights"):
        assert found[f"planar_{learned}_log_density"] == "not reproduced"


def test_what_needs_people_is_never_settled():
    found = claims(small_tables(), OBJECTS)
    assert [claim.name for claim in found if claim.verdict == "needs people"] == [
        f"users_{name}" for name in ("prefer", "helpful", "easy", "easier", "choice")
    ]


def test_tables_can_be_read_back_exactly():
    rows = small_tables()["learning"]
    lines = list(csv.DictReader(csv_of(rows).splitlines()))
    for name in ("log_density", "distance"):
        assert np.array_equal([float(line[name]) for line in lines], [row[name] for row in rows])


def test_every_figure_is_drawn(tmp_path):
    figures = CHAPTER4.figures(small_settings(), small_tables(), 3, tmp_path)
    assert [figure.number for figure in figures] == [
        "4.2",
        "4.3",
        "4.4",
        "4.5",
        "4.6",
        "4.7",
        "4.8",
        "4.8b",
        "4.9",
        "4.10",
    ]
    for figure in figures:
        assert [file.suffix for file in figure.files] == [".png", ".svg"]
        assert all(file.stat().st_size > 5000 for file in figure.files)


# Bad input.


def test_unknown_studies_are_refused():
    with pytest.raises(UnknownNameError, match="chapter4"):
        registry.study_named("chapter5")
    with pytest.raises(UnknownNameError, match="all"):
        registry.study_named("chapter 4")


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ("people: 0", "people"),
        ("rationality: .nan", "rationality"),
        ("strategies: [active, random]", "lacks passive"),
        ("strategies: [active, passive, random, clever]", "strategies"),
        ("particels: 3", "particels"),
        ("particles: many", "particles"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(tmp_path, change, field):
    content = (registry.__file__, load_chapter4_settings().model_dump(mode="json"))[1]
    key, value = change.split(": ", 1)
    lines = [f"{name}: {json.dumps(each)}" for name, each in content.items() if name != key]
    path = tmp_path / "chapter4.yaml"
    path.write_text("\n".join([*lines, f"{key}: {value}"]))
    with pytest.raises(BadModelError, match=field):
        read_yaml(path, Chapter4Settings)


def test_grasps_and_poses_that_are_not_there_are_refused():
    arm = load_chapter4_settings().arm
    unknown = arm.model_copy(update={"grasps": {"handlebars": ("middle",), "u_lock": ("left_leg",)}})
    with pytest.raises(UnknownNameError, match="left_thumb_inside"):
        offering(unknown)
    far = replace(offering(arm), settings=arm.model_copy(update={"least": (5.0, 5.0, 5.0), "most": (6.0, 6.0, 6.0)}))
    with pytest.raises(BadModelError, match="none of"):
        far.query(far.models[0], np.random.default_rng(0))
