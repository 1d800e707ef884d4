"""The conclusions of the study, on rows made here: figures by hand, gaps, and the stored page."""

import doctest
import json
import re
import sys
import tomllib
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.text import Text

from gbdqn_ref import UsageError, stats
from gbdqn_ref.schedule import LABELS

sys.path.append(str(Path(__file__).parents[1] / "benchmarks" / "keep"))
import conclude
import decide
import drawings
import evidence
from protocol import FILE, Protocol, settings_hash
from study import RESULTS, Store, chosen

BASES = "acrobot", "mountaincar", "cartpole"
METHODS = Protocol().content["tuning"]["methods"]
TUNED = {task: {method: {} for method in METHODS} for task in BASES}
CAR, NULL = "mountaincar", "mountaincar-null"  # events at 250, 350, 450 and 550 of 650 episodes
NOISE = np.random.default_rng(0).normal(0, 5, 40)
LEARNT = [[-110.0 if k % 2 == j % 2 else -200.0 for j in range(5)] for k in range(5)]


def run(value=-150.0, **values):
    """What a row of MountainCar has beside its name; nothing happens at its drifts."""
    regimes = dict(value=value, regimes=[value] * 5, first=[value] * 4, final=value)
    found = dict(recovery=[0] * 4, calm=[0] * 4, evaluation=LEARNT, alarms=[], steps=1)
    return regimes | found | values


def study_of(arms, task=CAR, returns=None):
    """A Study of {arm: rows of seeds 2000, 2001, …}; None is a run that is not there."""
    rows = {
        (task, arm, 2000 + k): each
        for arm, runs in arms.items()
        for k, each in enumerate(runs)
        if each is not None
    }
    protocol = Protocol(tuned=TUNED)
    returns = {task: returns or {}}
    return evidence.Study(SimpleNamespace(protocol=protocol, rows=rows, returns=returns))


def level(value, n=20):
    """n runs around a value, with the same noise for every arm."""
    return [run(value + noise) for noise in NOISE[:n]]


def cells(table, *key):
    """{header: cell} of the row that begins with these cells."""
    header, rows = table
    (found,) = [row for row in rows if tuple(row[: len(key)]) == key]
    return dict(zip(header, found, strict=True))


def test_the_examples_in_the_docstrings():
    assert [doctest.testmod(each) for each in (evidence, conclude, decide)] == [
        (0, 3),
        (0, 1),
        (0, 3),
    ]


def test_exact_intervals_by_hand():
    """None of n: 1 − .025^(1/n). 3 of 20: the tail on each side has 2.5 %."""
    assert evidence.exact_interval(0, 20) == pytest.approx((0, 1 - 0.025 ** (1 / 20)))
    assert evidence.exact_interval(20, 20) == pytest.approx((0.025 ** (1 / 20), 1))
    assert evidence.exact_interval(3, 20) == pytest.approx((0.0321, 0.3789), abs=1e-4)


# --- hypotheses -----------------------------------------------------------------------------------


def test_the_p_of_planted_leads():
    """H1 asks for more than 10. Leads of 11 from every seed leave the IQM as large unless more than
    five of 20 signs flip, 2.07 %. If leads differ, a flip of the five smallest only does (2⁻¹⁵).
    """
    arms = {"reuse-told": level(-130), "dqn-drop": level(-160), "dqn-drop-adam": level(-141)}
    row = cells(conclude.hypotheses(study_of(arms)), "H1")
    assert row["effect"] == "+11.0 [+11.0, +11.0] over dqn-drop-adam, mountaincar"
    assert float(row["p"].split(",")[0]) == pytest.approx(0.0207, abs=0.004)
    assert row["decision"] == "open"
    arms["reuse-told"] = [run(each["value"] + k / 10) for k, each in enumerate(level(-130))]
    row = cells(conclude.hypotheses(study_of(arms)), "H1")
    assert row["effect"].startswith("+12.0 [") and float(row["p"].split(",")[0]) <= 0.0003
    assert row["decision"] == "**holds**, at 20 seeds"


def test_a_hypothesis_without_its_seeds_is_open_and_shows_nothing():
    """24 runs with a gap are not the first 20 seeds."""
    arms = {"reuse-told": level(-100, 25), "dqn-drop-adam": level(-160, 25)}
    arms["dqn-drop"] = level(-160, 25)
    arms["dqn-drop"][7] = None
    row = cells(conclude.hypotheses(study_of(arms)), "H1")
    assert (row["effect"], row["p"], row["decision"]) == ("–", "–", "open")
    nothing = conclude.hypotheses(study_of({}))[1]
    assert len(nothing) == 8 and {row[-1] for row in nothing} == {"open"}


def test_the_page_shows_the_p_of_the_last_look_reached():
    arms = {"reuse-told": level(-130, 35), "dqn-drop": level(-160, 32)}
    arms["dqn-drop-adam"] = level(-160, 31)
    assert cells(conclude.hypotheses(study_of(arms)), "H1")["p"].endswith(", 30 seeds")


@pytest.mark.parametrize(("seeds", "decision"), [(39, "open"), (40, "not shown")])
def test_what_is_not_decided_at_the_last_look_is_not_shown(seeds, decision):
    """A lead of 9, where more than 10 is asked for."""
    arms = {"reuse-told": level(-130, seeds), "dqn-drop": level(-139, seeds)}
    arms["dqn-drop-adam"] = level(-160, seeds)
    assert cells(conclude.hypotheses(study_of(arms)), "H1")["decision"] == decision


@pytest.mark.parametrize(("p", "look"), [(0.002, 20), (0.0025, None)])
def test_missing_hypotheses_count_in_the_correction(monkeypatch, p, look):
    """Eight times .002 is below .05 / 3, eight times .0025 above, whatever is there."""
    monkeypatch.setattr(stats, "sign_flip_test", lambda *_: p)
    arms = {"reuse-told": level(-100), "dqn-drop": level(-160), "dqn-drop-adam": level(-160)}
    protocol = Protocol()
    results = {(CAR, arm): np.zeros(len(runs)) for arm, runs in arms.items()}
    decided = protocol.decisions(results, np.random.default_rng(0))
    assert decided.pop("H1") == look and set(decided.values()) == {None}


def test_a_p_does_not_depend_on_which_other_hypotheses_are_there():
    rng = np.random.default_rng(1)
    arms = ["reuse-told", "dqn-drop", "dqn-drop-adam", "twin-told", "twin-told-adam"]
    all_of_them = {(CAR, arm): rng.normal(size=20) for arm in arms}
    second = {run: all_of_them[run] for run in all_of_them if "drop" not in run[1]}
    p, alone = (Protocol().p_values(x, 20, np.random.default_rng(0)) for x in (all_of_them, second))
    assert p["H2"] == alone["H2"] < 1


# --- the tables -----------------------------------------------------------------------------------


def test_what_is_missing_is_said_for_the_first_look():
    row = cells(
        conclude.completeness(study_of({"dqn": level(-150, 21), "twin": level(-150, 3)})), CAR
    )
    assert row["stored, of the first look's 20 seeds"] == "23 of 320 runs"
    assert row["missing"].startswith("sliding 20, ") and ", twin 17, " in row["missing"]


def test_an_arm_is_compared_on_the_seeds_that_both_have():
    """The reference lacks the seed at which it would be 100 behind."""
    told = [run(-120.0), run(-130.0), run(-140.0), run(-50.0)]
    study = study_of({"dqn-drop": [run(-130.0), run(-140.0), run(-150.0)], "reuse-told": told})
    row = cells(conclude.arms(study, CAR, "oracle"), "reuse-told")
    assert row["minus dqn-drop"] == "+10.0 [+10.0, +10.0]"
    assert (row["IQM"], row["mean"], row["worst"]) == ("-125.0", "-110.0", "-140.0")
    assert row["better"] == "0.83"  # 2.5, 2, 1.5 … of 3 each: 10 of 12
    assert cells(conclude.arms(study, CAR, "oracle"), "dqn-drop")["minus dqn-drop"] == ""


def test_a_run_fails_below_the_middle_between_random_and_the_best_arm():
    """Random is −200, the best arm −110: the bar is −155. A diverged run fails, and is counted."""
    ends = [run(final=-110.0)] * 17 + [run(final=-154.0), run(final=-156.0)]
    diverged = run(-200.0, evaluation=[], diverged="DivergenceError")
    study = study_of({"dqn-drop": [*ends, diverged], "dqn": [run(final=-199.0)] * 20})
    table = conclude.arms(study, CAR, "oracle")
    assert cells(table, "dqn-drop")["failed"] == "2 of 20 [1%, 32%], 1 diverged"
    assert cells(table, "dqn")["failed"] == "20 of 20 [83%, 100%]"
    (full,) = [x for seed, x in study.curves(CAR, "dqn-drop").items() if seed == 2019]
    assert len(full) == 650 and set(full) == {-200.0}


def test_adaptation_by_hand():
    """Before each drift −110, a gain of 90; after it 20 episodes at −155, then −110 again."""
    returns = np.full(650, -110.0)
    for start in (250, 350, 450, 550):
        returns[start : start + 20] = -155.0
    found = dict(first=[-155.0, -120.0, -155.0, -130.0], recovery=[0, 17, None, 19])
    study = study_of({"dqn-drop": [run(**found)]}, returns={"dqn-drop-2000": returns})
    row = cells(conclude.adaptation(study, CAR), "dqn-drop")
    assert row["drop"] == "50%" and row["area lost"] == "10%"
    assert row["back in stock"] == "-125.0", "the second and the fourth drift lead there"
    assert row["recovered after"] == "19", "never is long, and a return that did not fall is none"
    assert row["forgotten"] == "45.0", "90 in two regimes, 0 in the two that are like the last"


def test_an_arm_without_returns_or_evaluations_has_dashes():
    diverged = run(-200.0, evaluation=[], recovery=[None] * 4, diverged="DivergenceError")
    table = conclude.adaptation(study_of({"gb-drop": [diverged], "dqn": [diverged]}), CAR)
    for row in (cells(table, arm) for arm in ("gb-drop", "dqn")):
        assert (row["drop"], row["area lost"], row["forgotten"]) == ("–", "–", "–")
        assert row["recovered after"] == "never"


@pytest.mark.parametrize("arm", conclude.HEARING)
def test_an_arm_and_its_oracle_differ_in_what_they_hear_only(arm):
    arms = [arm, *filter(None, conclude.HEARING[arm])]
    heard = [Protocol().config(CAR, each, 2000).resolved().to_dict() for each in arms]
    signals = [each.pop("drift_signal") for each in heard]
    assert signals[:2] == ["detector", "schedule"] and heard == heard[:1] * len(heard)


def test_regret_is_to_the_same_arm_with_an_oracle():
    arms = {"reuse": level(-140), "reuse-told": level(-130), "reuse-random": level(-170)}
    row = cells(conclude.hearing(study_of(arms)), CAR, "reuse")
    assert row["minus the same arm, told"].startswith("−10.0 [")
    assert row["minus it with random alarms"].startswith("+30.0 [")


def test_alarms_are_counted_from_costly_drifts():
    """Of four costly drifts the first is found in 3, the third too late. False are the second alarm
    at 600, and 100: the one at 255 answers a drift, if none that costs anything.
    """
    known = run(alarms=[252, 465, 555, 600])
    never_learnt = run(evaluation=[[-200.0] * 5] * 5, alarms=[100, 255])
    mastered = np.where(np.array(LEARNT) > -200, -110.0, -150.0).tolist()  # more than half is left
    runs = [known, never_learnt, run(evaluation=mastered), run(evaluation=[])]
    row = cells(conclude.detection(study_of({"reuse": runs})), CAR, "reuse")
    assert row["costly drifts found"] == "2 of 4" and row["median delay"] == "4.5"
    assert row["false alarms per run"] == "0.50" and row["target"] == "missed"
    quiet = study_of({"reuse": [run(alarms=[300])] + [run()] * 19}, NULL)
    row = cells(conclude.detection(quiet), NULL, "reuse")
    assert (row["false alarms per run"], row["target"]) == ("0.05", "met")
    runs = [run(alarms=[425, 445], evaluation=[])]
    held_out = study_of({"reuse": runs}, "mountaincar-held-out")
    row = cells(conclude.detection(held_out), "mountaincar-held-out", "reuse")
    assert row["false alarms per run"] == "0.00", "each is the first after a step of the drift"
    told = study_of({"dqn-drop": [run(alarms=[252])]}, NULL)
    assert conclude.detection(told)[1] == [], "it detects nothing"


def test_what_the_null_costs_in_percent_of_the_span():
    """DQN ends at −110, 90 above random; 3 less are 3.3 %, 6 less 6.7 %."""
    untold = [run(-120.0, final=-110.0)] * 5
    arms = {"dqn-untold": untold, "reuse": [run(-123.0)] * 5, "dqn-drop": [run(-126.0)] * 5}
    arms["twin-adam"] = [run(-120.0 + lead) for lead in (-11, 5, -9, 3, -2)]
    table = conclude.nulls(study_of(arms, NULL))
    rows = {arm: cells(table, NULL, arm) for arm in ("reuse", "dqn-drop", "twin-adam")}
    assert rows["reuse"]["% of the span, minus dqn-untold"] == "−3.3 [−3.3, −3.3]"
    small = [row["within 5 %"] for row in rows.values()]
    assert small == ["yes", "not shown", "not shown"], "the last one's interval is wide"
    assert len(table[1]) == 3


def test_a_lead_on_the_held_out_schedule_has_its_sign_or_not():
    """Dropped data are ahead on both, reuse on one; what is as good on one of them is open."""
    arms = "dqn", "dqn-drop", "twin-adam", "reuse"
    own, other = (
        {arm: level(value) for arm, value in zip(arms, values, strict=True)}
        for values in ((-190, -150, -150, -140), (-180, -160, -150, -170))
    )
    study = study_of(own)
    study.rows |= study_of(other, "mountaincar-held-out").rows
    _, rows = conclude.held_out(study)
    assert [row[0] for row in rows] == [CAR] * 4
    assert [row[-1] for row in rows] == ["ahead on both", "open", "the opposite", "the opposite"]
    assert rows[0][2:4] == ["+40.0 [+40.0, +40.0]", "+20.0 [+20.0, +20.0]"]
    del study.rows[CAR, "reuse"][2003]
    assert conclude.held_out(study)[1][2][2:] == ["–", "−10.0 [−10.0, −10.0]", "open"]


def test_equal_steps_are_counted_from_the_first_event():
    """400 episodes of 100 steps are as many as 200 of 150 and 50 of 200, whose mean is 160."""
    long = np.concatenate([np.full(250, -1.0), np.full(200, -150.0), np.full(200, -200.0)])
    short = np.concatenate([np.full(250, -200.0), np.full(400, -100.0)])
    returns = {"dqn-2000": long, "dqn-drop-2000": short}
    study = study_of({"dqn": [run(-175.0)], "dqn-drop": [run(-100.0)]}, returns=returns)
    row = cells(conclude.per_step(study), CAR, "dqn")
    assert (row["at equal episodes"], row["at equal steps"]) == ("−75.0", "−60.0")


def predicted(**lead):
    """Arms as predicted: the data bring 30, networks 20, Adam 5; the lead grows with visits."""
    told = dict(regimes=[-100.0, -140.0, -110.0, -110.0, -110.0]) | lead
    arms = dict.fromkeys(["dqn", "plasticity"], -180), {"dqn-drop": -150, "dqn-drop-adam": -145}
    arms = arms[0] | arms[1] | {"twin-told": -140, "twin-told-adam": -138, "gb-drop": -135}
    rows = {arm: level(value) for arm, value in arms.items()}
    rows["reuse-told"] = [run(-130.0 + noise, **told) for noise in NOISE[:20]]
    rows["reuse"] = [run(calm=[3] * 4, recovery=[9, 9, None, 0])] * 20
    return rows


def test_predictions_are_scored_by_their_rule():
    _, rows = conclude.predictions(study_of(predicted()))
    marks = [(row[0], row[-1]) for row in rows]
    assert marks == [("`P1`", "holds"), ("`P1`", "holds"), ("`P2`", "holds"), ("`P3`", "holds")]
    assert [row[-2].split(" ")[0] for row in rows] == ["+10.0", "+15.0", "+26.5", "+30.0"]
    assert rows[0][3].startswith("reuse-told − dqn-drop: +20.0")
    assert rows[1][3].startswith("dqn-drop-adam − dqn-drop: +5.0")
    lines = conclude.verdicts(study_of(predicted()))
    assert lines.count("**open**") == 3, "the other tasks are missing"
    noisy = predicted() | {"dqn": [run(-180.0 + 60 * (-1) ** k) for k in range(20)]}
    assert conclude.predictions(study_of(noisy))[1][0][-1] == "open"
    few = {arm: rows[:19] for arm, rows in predicted().items()}
    assert {row[-1] for row in conclude.predictions(study_of(few))[1]} == {"open"}
    worse = study_of(predicted(regimes=[-100.0, -110.0, -140.0, -140.0, -140.0]))
    assert "`P3` **fails**" in conclude.verdicts(worse)


def test_what_tuning_chose(tmp_path):
    worse, better = ({"lr": f, "window": f, "epsilon_restart": f / 10} for f in (0.5, 2.0))
    first, chosen = (
        [[worse, -9.0], [better, -8]],
        dict(lr=0.00212, window=4207, epsilon_restart=0.2),
    )
    tried = {"twin": {"chosen": chosen, "first": first, "best": [[0, -7.0], [1, -6.0]]}}
    (tmp_path / "acrobot-tuned.json").write_text(json.dumps(tried), encoding="utf-8")
    row = [
        "acrobot",
        "twin",
        "lr 0.00212 (× 2.00), window 4207 (× 2.00), epsilon_restart 0.2",
        "-6.0",
    ]
    assert conclude.tuning(tmp_path)[1] == [row]


# --- the page and the picture ---------------------------------------------------------------------


@pytest.fixture
def stored(tmp_path):
    """A folder with three runs of each of two arms, and the settings that were tuned."""
    best = {"chosen": {}, "first": [[{}, -9.0]], "best": [[0, -7.0]]}
    for task in BASES:
        text = json.dumps(dict.fromkeys(METHODS, best))
        (tmp_path / f"{task}-tuned.json").write_text(text, encoding="utf-8")
    protocol, rng = Protocol(tuned=chosen(tmp_path)), np.random.default_rng(0)
    store = Store(protocol, tmp_path)
    for arm in ("dqn", "reuse"):
        for seed in (2000, 2001, 2002):
            config, returns = protocol.reported(CAR, arm, seed), rng.normal(-150, 9, 650)
            store.add(CAR, arm, config, run(float(returns[250:].mean())), returns)
            assert store.rows[CAR, arm, seed]["settings"] == settings_hash(config)
    store.write()
    return tmp_path


def test_a_page_of_a_study_that_is_under_way(stored):
    conclude.main([f"--results={stored}"])
    page = (stored / "README.md").read_text(encoding="utf-8")
    assert "| mountaincar | 6 of 320 runs | dqn 17, sliding 20" in page
    assert "| acrobot | 0 of 320 runs | all |" in page and page.count("(keep.png)") == 1
    assert not re.search(r"[{}]|\bnan\b", page) and page.endswith("|\n")
    for table in re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE):
        widths = {len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}
        assert len(widths) == 1, table


def test_the_picture_has_a_row_per_task_and_names_every_arm(stored):
    study = evidence.stored(stored)
    figure = drawings.picture(study)
    left, right = figure.axes
    assert {text.get_text() for text in left.texts} == {"DQN", "GB-DQN-reuse"}
    assert min(text.get_fontsize() for text in figure.findobj(Text)) >= 9
    assert len(left.lines) == 2 * (3 + 1) + 2, "every seed, the IQM, and one beside each name"
    smooth = stats.trailing_mean(study.curves(CAR, "dqn")[2001], 10)
    assert np.array_equal(left.lines[1].get_ydata(), smooth)
    assert left.lines[1].get_xdata()[-1] == 649
    value = sorted(study.values(CAR, "dqn")[0])
    profile = right.lines[0].get_xydata()
    assert right.lines[0].get_drawstyle() == "steps-pre"
    ends = [[value[0], 1], [value[1], 2 / 3], [value[2], 1 / 3], [value[2], 0]]
    np.testing.assert_allclose(profile, ends)


def test_around_a_reversal_every_seed_is_drawn(stored):
    """MountainCar's motor is reversed in episodes 250 and 450."""
    study = evidence.stored(stored)
    figure = drawings.around(study)
    assert [axes.get_title("left") for axes in figure.axes] == ["DQN", "GB-DQN-reuse"]
    for axes in figure.axes:
        assert len(axes.lines) == 3 + 2, "every seed, the IQM and the reversal"
    returns = study.curves(CAR, "dqn")[2001]
    mean = (returns[230:310] + returns[430:510]) / 2
    np.testing.assert_allclose(figure.axes[0].lines[1].get_ydata(), mean)
    assert figure.axes[0].lines[1].get_xdata().tolist() == [*range(-20, 60)]
    assert min(text.get_fontsize() for text in figure.findobj(Text)) >= 9


@pytest.mark.parametrize("program", [conclude, decide])
def test_a_folder_without_runs_is_refused_and_nothing_is_written(tmp_path, program):
    """Its README may be anybody's, and the answer would be lost."""
    files = tmp_path / "results" / "README.md", tmp_path / "README.md", tmp_path / "page.md"
    files[0].parent.mkdir()
    for path in files:
        path.write_text(f"mine {decide.BEFORE} {decide.AFTER}", encoding="utf-8")
    before = [path.read_bytes() for path in files]
    words = [f"--readme={files[1]}", f"--page={files[2]}"] if program is decide else []
    for folder in ("results", "nowhere", "page.md"):
        with pytest.raises(UsageError, match=f"there is no run in .*{folder}"):
            program.main([f"--results={tmp_path / folder}", *words])
    assert [path.read_bytes() for path in files] == before
    assert {path.name for path in tmp_path.iterdir()} == {"results", "README.md", "page.md"}


def test_a_study_that_ends_soon_after_a_drift_is_drawn():
    """The fast one has 40 episodes after its drift. An exploratory one has no pictures."""
    protocol = Protocol(FILE.with_name("fast.toml"), {"acrobot": {"own": {}}})
    returns = {"acrobot": {f"dqn-{seed}": np.full(140, -100.0) for seed in (0, 1)}}
    rows = {("acrobot", "dqn", seed): run() for seed in (0, 1)}
    study = evidence.Study(SimpleNamespace(protocol=protocol, rows=rows, returns=returns))
    episode, found = drawings.aligned(study, "acrobot", "dqn")
    assert (episode[0], episode[-1]) == (-20, 39) and found.shape == (2, 60)
    assert [*drawings.drawn(study)] == ["acrobot"]
    protocol.hypotheses = []
    assert drawings.drawn(study) == {}


def test_runs_without_returns_have_a_page_and_no_picture(stored):
    (stored / "mountaincar.npz").unlink()
    conclude.main([f"--results={stored}"])
    assert not list(stored.glob("*.png"))
    assert "keep.png" not in (stored / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("text", ["mine", 2 * (decide.BEFORE + decide.AFTER)])
def test_a_readme_without_one_place_for_the_table_is_refused(tmp_path, stored, text):
    readme, page = tmp_path / "READ.md", tmp_path / "page.md"
    readme.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="a README has its table between"):
        decide.main([f"--results={stored}", f"--readme={readme}", f"--page={page}"])
    assert readme.read_text(encoding="utf-8") == text and not page.exists()


def test_the_stored_page_is_what_the_program_writes():
    page, picture = RESULTS / "README.md", RESULTS / "keep.png"
    if not (RESULTS / "rows.jsonl").exists():
        assert not page.exists() and not picture.exists() and not decide.PAGE.exists()
        return
    study = evidence.stored()
    assert page.read_text(encoding="utf-8") == conclude.page(study, RESULTS)
    for drawing in (picture, picture.with_name("drifts.png")):
        assert drawing.stat().st_size <= 300_000
    assert decide.PAGE.read_text(encoding="utf-8") == decide.page(study)
    readme = (decide.ROOT / "README.md").read_text(encoding="utf-8")
    assert readme == decide.readme(study, readme)


@pytest.mark.parametrize("name", ["settings", "network", "hopper"])
def test_the_page_of_an_exploratory_protocol(name):
    """It tests nothing, and says so."""
    results = RESULTS / name
    study = evidence.stored(results, FILE.with_name(f"{name}.toml"))
    text = (results / "README.md").read_text(encoding="utf-8")
    assert text == conclude.page(study, results)
    assert text.startswith(f"# {study.protocol.content['question']}\n")
    assert "Exploratory" in text and "Hypotheses" not in text
    told = (conclude.TEXT.parent / "README.md").read_text(encoding="utf-8")
    for task, arm in product(study.protocol.tasks, study.protocol.arms):
        level = evidence.signed(evidence.middle(study.values(task, arm)[0]))
        assert f"| {arm} | {level} |" in text
        if arm != study.reference["oracle"]:
            apart = evidence.words(study.difference(task, arm, study.reference["oracle"]))
            assert apart in text and apart in told


def test_the_ledger_says_which_tasks_its_verdicts_rest_on():
    """A task whose runs become complete asks for its rows to be read again."""
    study = evidence.stored()
    complete = [
        LABELS[task]
        for task in study.tasks("oracle")
        if all(len(study.complete(task, arm, "dqn")) for arm in study.protocol.arms_of(task))
    ]
    path = decide.ROOT / "paper_checks" / "claims" / "keep.toml"
    rows = tomllib.loads(path.read_text(encoding="utf-8"))
    for id in ("X28", "X30", "X31", "X32", "X33", "X34"):
        assert all(label in rows[id]["extent"] for label in complete), id


def test_what_is_said_of_hopper():
    """Of arms that its page does not compare, and of the greedy policy around the first drift."""
    text = (conclude.TEXT.parent / "README.md").read_text(encoding="utf-8")
    text = text.partition("## On Hopper")[2].partition("\n## ")[0].replace("\n   ", " ")
    study = evidence.stored(RESULTS / "hopper", FILE.with_name("hopper.toml"))
    for arm, other, of in (("dqn", "dqn-drop", "first"), ("twin-told-adam", "reuse-told", "value")):
        figure = evidence.words(study.difference("hopper", arm, other, of)).replace("+", "")
        assert figure in text, figure
    ends = stats.iqm(study.values("hopper", "dqn", of="final")[0])
    for regime in (0, 1):  # of the policy before the first drift, in the stock and drifted physics
        (x,) = study.values("hopper", "dqn", of=lambda row, k=regime: row["evaluation"][0][k])
        assert f"{x.min():.0f} to {x.max():.0f}" in text
    assert f"{ends:,.0f}" in text


def test_how_often_tuning_raised_epsilon():
    raised = [
        each["epsilon_restart"] > 0 for task in chosen(RESULTS).values() for each in task.values()
    ]
    assert f"In {raised.count(False)} of {len(raised)} choices" in decide.TEXT.read_text("utf-8")
    page = (decide.ROOT / "site/what_to_keep.md").read_text(encoding="utf-8")
    assert f"raised it in {sum(raised)} of {len(raised)} choices" in page
    assert chosen(RESULTS)["cartpole"]["dqn-drop"]["epsilon_restart"] == 0.3


# --- the answer -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("told", "adam", "reuse", "answer"),
    [
        (-140, -145, -130, "Boosting adds to reuse, and reuse to boosting"),
        (-160, -150, -147, "Boosting adds to reuse; that reuse adds to it is not shown"),
        (-140, -130, -130, "Reuse, not boosting, gains here: a booster is not shown to add to it"),
        (-140, -145, -155, "Reuse, not boosting, gains here: a booster takes from it"),
    ],
)
def test_the_answer_is_against_the_better_twin(told, adam, reuse, answer):
    levels = {"dqn-drop": -150, "twin-told": told, "twin-told-adam": adam, "reuse-told": reuse}
    levels["gb-drop"] = -147
    levels |= {"dqn-detected": -150, "reuse": -140, "twin": -143, "twin-adam": -145}
    arms = {arm: [run(value + k % 3) for k in range(20)] for arm, value in levels.items()}
    for k, each in enumerate(arms["dqn-drop"]):
        each["value"] += (-1) ** k * 0.5
    found = decide.answer(study_of(arms))
    assert found.startswith(f"- **MountainCar.** {answer}.\n\n|  | MountainCar |")
    lead = evidence.words(np.full(20, float(reuse - max(told, adam))))
    assert f"| told: both, over stored networks | {lead}, mean " in found
    assert "| told: a booster, over the same | +3.0 [+2.5, +3.5], mean +3.0 |" in found
    assert "| detecting: both, over stored networks | +3.0 [+3.0, +3.0], mean +3.0 |" in found


@pytest.mark.parametrize(
    ("boost", "both", "answer"),
    [
        (True, True, "A booster gains; that it adds to reuse, or reuse to it, is not shown."),
        (False, True, "Reuse with boosting gains; neither is shown to gain alone."),
        (False, False, "Nothing is detected beyond DQN that drops its data."),
    ],
)
def test_a_gain_is_not_given_to_reuse_where_only_others_are_shown(boost, both, answer):
    unsure, some = np.array([-3.0, -1, 0, 1, 2, 4, 5, 6, -2]), np.full(9, 4.0)
    boost, both = (some if shown else unsure for shown in (boost, both))
    assert decide.verdict(unsure, boost, both, unsure, unsure) == answer


@pytest.mark.parametrize(
    ("told", "detecting", "says"),
    [
        (5, 5, "boosting adds to reuse, whether the agent is told or detects"),
        (5, 0, "boosting {adds} where the agent is told, and {open} where it detects"),
        (0, 5, "boosting {open} where the agent is told, and {adds} where it detects"),
        (5, -5, "boosting {adds} where the agent is told, and {takes} where it detects"),
        (0, 0, "{gains}boosting {open}, whether the agent is told or detects"),
        (-5, -5, "{gains}boosting {takes}, whether the agent is told or detects"),
        (0, -5, "{gains}boosting {open} where the agent is told, and {takes} where it detects"),
    ],
)
def test_the_first_sentence_says_where_boosting_adds_to_reuse(told, detecting, says):
    twins = dict.fromkeys([*evidence.TWINS[0], *evidence.TWINS[1]], -150)
    arms = twins | {"dqn-drop": -170, "reuse-told": -150 + told, "reuse": -150 + detecting}
    arms["dqn-detected"] = -170
    words = dict(
        adds="adds to reuse", open="is not shown to add to reuse", takes="takes from reuse"
    )
    says = says.format(gains="reuse, not boosting, gains: ", **words)
    arms = {arm: level(value) for arm, value in arms.items()}
    for arm, lead in (("reuse-told", told), ("reuse", detecting)):
        for k, each in enumerate(arms[arm]):
            each["value"] += (-1) ** k * (lead == 0)  # else a lead of 0 has no interval
    assert evidence.first_sentence(study_of(arms)) == f"On MountainCar {says}."
    del arms["reuse"]
    assert evidence.first_sentence(study_of(arms)) == "No task is complete yet."


def test_a_target_is_met_by_the_smallest_lead_or_missed_with_a_reason():
    hopes = [each for each in conclude.TARGETS if each["task"] == CAR]
    told, twins = hopes[0], hopes[1]
    assert (told["least"], twins["least"], twins["low"]) == (10.0, 0.0, True)
    arms = {"reuse-told": level(-130), "dqn-drop": level(-145), "dqn-drop-adam": level(-140)}
    arms |= {"twin-told": level(-130), "twin-told-adam": level(-140)}
    first, second = conclude.targets(study_of(arms))[1]
    assert first[2:] == ["≥ 10", "+10.0 [+10.0, +10.0] over dqn-drop-adam", "met"]
    assert second[2:] == ["lower end ≥ 0", "+0.0 [+0.0, +0.0] over twin-told", "met"]


def test_a_target_that_is_missed_has_its_reason(monkeypatch):
    target = dict(conclude.TARGETS[0], why="of this") | {"of": "first", "least": 11.0}
    monkeypatch.setattr(conclude, "TARGETS", [target])
    arms = {"reuse-told": -130, "dqn-drop": -140, "dqn-drop-adam": -145}
    study = study_of({arm: level(value) for arm, value in arms.items()})
    ((*_, measured, verdict),) = conclude.targets(study)[1]
    assert measured == "+10.0 [+10.0, +10.0] over dqn-drop"
    assert verdict == "missed: of this"


def test_what_the_answer_says_of_two_hypotheses():
    """That boosting adds to reuse on MountainCar is shown where the agent detects, and not told."""
    _, rows = conclude.hypotheses(evidence.stored())
    marks = {id: mark for id, *_, mark in rows}
    assert marks["H2"] == "not shown" and "holds" in marks["H7"]


def test_every_target_is_measured():
    _, rows = conclude.targets(evidence.stored())
    assert len(rows) == len(conclude.TARGETS)


def test_the_leads_that_decide_have_all_their_measures():
    arms = {"dqn": [run(-190.0, first=[-195.0] * 4, final=-180.0)] * 20}
    arms["dqn-drop"] = [run(-150.0, first=[-199.0] * 4, final=-140.0)] * 20
    _, ((task, lead, *measured),) = conclude.pairs(study_of(arms))
    assert (task, lead) == (CAR, "dqn-drop − dqn")
    ends = [f"{x} [{x}, {x}]" for x in ("+40.0", "−4.0", "+40.0")]
    assert [evidence.signed(each) for each in measured] == [*ends, "–", "1.00"]


def test_a_text_has_the_difference_that_it_names():
    study = study_of({"dqn": level(-190), "dqn-drop": level(-150)})
    text = "({lead:mountaincar dqn-drop dqn}, {lead:mountaincar dqn-drop dqn final})"
    found = text.format(lead=evidence.Leads(study))
    assert found == "(+40.0 [+40.0, +40.0], +40.0 [+40.0, +40.0])"


def test_an_environment_whose_runs_are_missing_has_no_answer():
    assert decide.answer(study_of({"dqn-drop": level(-150)})) == "No run is complete yet."


def test_each_choice_has_its_difference_and_its_command():
    arms = {"dqn": level(-190), "dqn-drop": level(-150)}
    header, rows = decide.table(study_of(arms))
    assert header == [
        "you know that",
        "choice",
        "Acrobot",
        "MountainCar",
        "CartPole",
        header[-1],
    ]
    assert rows[0][2:] == ["–", "+40.0 [+40.0, +40.0]", "–", "`again.py TASK dqn-drop dqn`"]
    _, few = decide.table(study_of(arms | {"dqn": level(-190, 19)}))
    assert few[0][2:5] == ["–", "–", "–"], "not before the first look"
    for row in rows:
        task, *arms = re.search(r"again\.py TASK(\S*) (\S+) (\S+)`", row[-1]).groups()
        assert set(arms) <= set(Protocol().arms_of(CAR + task)), row


def test_the_readme_has_the_level_of_each_agent():
    arms = {arm: 9 * [run(-100.0 - 10 * k)] for k, arm in enumerate(decide.AGENTS)}
    text = f"Above.\n{decide.BEFORE}old\n{decide.AFTER}\nBelow.\n"
    found = decide.readme(study_of(arms), text)
    row = "| GB-DQN, the paper's | schedule | −120.0 [−120.0, −120.0], 9 runs |"
    assert row in found and "\nold\n" not in found
    assert found.startswith("Above.") and found.endswith("Below.\n")
    assert decide.readme(study_of(arms), found) == found
    header, _ = decide.levels(study_of({"dqn": level(-100.0)}))
    assert header == ["agent", "drift signal"], "a task that lacks an agent is left out"
