"""What an agent keeps at a drift (data, network, Adam, stages), and how stages compete."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers import SMALL, agent_of, drifts_at, feed, state_bytes, states

from gbdqn_ref import checkpoint
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.boosting import Ensemble
from gbdqn_ref.detect import REFERENCE, SLACK, Detector
from gbdqn_ref.nn import MLP
from gbdqn_ref.reuse import PATIENCE, SHELF, TURNS, WINDOW
from gbdqn_ref.train import Config, make_agent, run

DRIFTING = SMALL | dict(schedule=drifts_at(4, 7, 10), capacity=400)
KEEPING = dict(warm_start=True, zero_output=False, alpha=1.0, keep_data=1.0, keep_adam=True)
learners = pytest.mark.parametrize("agent", sorted(set(AGENTS) - {"random"}))


def play(agent, total, steps=5):
    """An episode with so many steps and this return."""
    feed(agent, steps, seed=agent.steps, learn=0)
    agent.end_episode(total, 0.5)


# --- data -----------------------------------------------------------------------------------------


@learners
def test_dropped_data_are_never_learnt_from_again(agent):
    agent = agent_of(agent, keep_data=0.0, drift_signal="schedule")
    feed(agent, 40)
    agent.on_drift("drift")
    assert len(agent.replay) == 0
    assert agent.learning_starts == agent.steps + SMALL["batch_size"]
    old = agent.replay.s.copy()
    feed(agent, 10, seed=1, learn=0)
    batch = agent.replay.sample(200, agent.rng)
    assert not (batch.s[:, None] == old[None]).all(-1).any()
    assert len(np.unique(batch.index)) == 10
    agent.replay.check_valid()


@pytest.mark.parametrize(("part", "left"), [(0.0, 6), (0.25, 14), (0.5, 23), (1.0, 40)])
def test_fresh_data_and_the_newest_part_of_older_data_are_kept(part, left):
    agent = agent_of("dqn", keep_data=part)
    feed(agent, 40)
    stored = agent.replay.s[:40].copy()
    agent.on_drift("drift", fresh=6)
    assert len(agent.replay) == left
    np.testing.assert_array_equal(agent.replay.s[agent.replay.slots()], stored[40 - left :])


def test_learning_resumes_once_there_is_a_batch():
    config = Config(agent="dqn", keep_data=0.0, **DRIFTING)
    agent, updates = make_agent(config), []
    for record in run(config, agent):
        updates.append(agent.adam.t)
        if record["episode"] in (4, 7, 10):
            assert len(agent.replay) == record["length"]
    assert updates[-1] > updates[10] > 0


def test_keeping_the_last_transitions_equals_a_sliding_window():
    whole, window = agent_of("dqn", capacity=90), agent_of("dqn", capacity=30)
    for agent in (whole, window):
        feed(agent, 60, learn=0)
    whole.replay.keep(30)
    assert len(whole.replay) == len(window.replay) == 30
    newest_first = []
    for replay in (whole.replay, window.replay):
        slots = replay.slots()
        newest_first.append(replay.s[slots[np.argsort(replay.age(slots))]])
    np.testing.assert_array_equal(*newest_first)
    np.testing.assert_allclose(whole.replay.probabilities(), window.replay.probabilities())


# --- Adam, the step size, ε -----------------------------------------------------------------------


@learners
def test_adam_is_kept_or_restarted_as_configured(agent):
    for keep in (True, False):
        learner = agent_of(agent, keep_adam=keep)
        feed(learner, 20)
        assert learner.adam.t == 20
        learner.on_drift("reset")
        kept = keep and agent != "gbdqn-reuse"  # it starts a booster, with fresh weights
        assert (learner.adam.t, learner.adam.m.any()) == ((20, True) if kept else (0, False))


@learners
def test_the_step_size_changes_at_the_first_event_and_stays(agent):
    learner = agent_of(agent, lr=0.01, lr_factor=5.0)
    feed(learner, 20)
    assert learner.adam.lr == 0.01
    for event in ("drift", "reset", "drift"):
        learner.on_drift(event)
        feed(learner, 5)
        assert learner.adam.lr == (0.0 if agent == "frozen" else 0.05)


def test_epsilon_rises_at_an_event_and_decays_again():
    agent = agent_of("dqn", epsilon_restart=0.5, epsilon_decay_steps=100)
    feed(agent, 150, learn=0)
    assert agent.epsilon == pytest.approx(0.05)
    agent.on_drift("drift")
    assert agent.epsilon == 0.5
    feed(agent, 50, learn=0)
    assert agent.epsilon == pytest.approx(0.275)
    feed(agent, 90, learn=0)
    assert agent.epsilon == pytest.approx(0.05)


def test_an_event_never_lowers_epsilon():
    agent = agent_of("dqn", epsilon_restart=0.2, epsilon_decay_steps=100)
    feed(agent, 10, learn=0)
    before = agent.epsilon
    agent.on_drift("drift")
    assert before == pytest.approx(0.905) and agent.epsilon == before


# --- identities -----------------------------------------------------------------------------------


@pytest.mark.parametrize("agent", ["gbdqn", "gbdqn-reuse"])
def test_a_warm_start_with_alpha_1_that_keeps_everything_is_dqn(agent):
    """To the bit, over more than a thousand updates and three events."""
    schedule = [{"episode": k, "length": 2} for k in (6, 12, 18)]
    values = dict(replay="proportional", drift_signal="schedule", update_every=1)
    values = SMALL | values | dict(schedule=schedule, episodes=60, capacity=3000)
    twin, dqn = (make_agent(Config(agent=name, **values | KEEPING)) for name in ("gbdqn", "dqn"))
    records = [[repr(record) for record in run(each.config, each)] for each in (twin, dqn)]
    assert records[0] == records[1] and dqn.adam.t > 1000
    assert np.array_equal(twin.theta, dqn.theta) and np.array_equal(twin.adam.m, dqn.adam.m)
    assert len(twin.ensemble) == 3 and not twin.ensemble.weight.any()


@pytest.mark.parametrize("warm", [True, False])
def test_a_booster_with_zero_output_changes_no_action(warm):
    agent = agent_of("gbdqn", alpha=1.0, warm_start=warm, zero_output=True)
    feed(agent, 40)
    before = agent.q(states())
    hidden = agent.net.layers(agent.theta)[0].copy()
    agent.on_drift("drift")
    assert np.array_equal(agent.q(states()), before)
    assert np.array_equal(agent.net.layers(agent.theta)[0], hidden) == warm


@pytest.mark.parametrize("alpha", [1.0, 0.3])
def test_a_warm_start_changes_no_value(alpha):
    """h_{m+1} = h_m takes over its part of α_m; the frozen sum keeps the rest."""
    agent = agent_of("gbdqn", alpha=alpha, warm_start=True, zero_output=False)
    feed(agent, 40)
    for _ in range(3):
        before = agent.q(states())
        agent.on_drift("drift")
        np.testing.assert_allclose(agent.q(states()), before, rtol=1e-5, atol=1e-6)
        feed(agent, 10, seed=1)


def test_cached_predictions_equal_the_frozen_sum():
    agent = agent_of("gbdqn-reuse", keep_data=0.5)
    for k in range(5):
        feed(agent, 30, seed=k)
        agent.on_drift("drift", fresh=7)
        for _ in range(SHELF):
            play(agent, float(k))
        slots = agent.replay.slots()
        s, a, s2 = (getattr(agent.replay, name)[slots] for name in ("s", "a", "s2"))
        expected = agent.ensemble.q(s)[np.arange(len(a)), a]
        np.testing.assert_allclose(agent.q_frozen[slots], expected, rtol=1e-4, atol=1e-5)
        expected = agent.ensemble.q(s2)
        np.testing.assert_allclose(agent.q_frozen_next[slots], expected, rtol=1e-4, atol=1e-5)


# --- stages ---------------------------------------------------------------------------------------


def test_the_stages_are_rows_of_weights():
    """α = 1, 2, 3 with use(0) in between: Q_3 = h₁ + 3 h₃."""
    net, rng = MLP((2, 3, 2)), np.random.default_rng(0)
    ensemble, thetas = Ensemble(net), net.init(rng, 3)
    ensemble.add(thetas[0], 1.0)
    ensemble.add(thetas[1], 2.0)
    ensemble.use(0)
    ensemble.add(thetas[2], 3.0)
    assert ensemble.stages().tolist() == [[1, 0, 0], [1, 2, 0], [1, 0, 3]]
    x = rng.normal(size=(5, 2)).astype(np.float32)
    h = np.stack([net.forward(theta, x)[0] for theta in thetas])
    np.testing.assert_allclose(ensemble.staged_q(x)[2], h[0] + 3 * h[2], rtol=1e-5)
    np.testing.assert_allclose(ensemble.q(x), h[0] + 3 * h[2], rtol=1e-5)
    ensemble.use(1)
    np.testing.assert_allclose(ensemble.q(x), h[0] + 2 * h[1], rtol=1e-5)


def test_a_carried_weight_is_subtracted_from_the_sum_but_not_from_the_stage():
    net = MLP((2, 3, 2))
    ensemble, theta = Ensemble(net), net.init(np.random.default_rng(0))
    ensemble.add(theta, 1.0, carried=0.25)
    assert ensemble.weight.tolist() == [0.75] and ensemble.stages().tolist() == [[1.0]]


# --- competition ----------------------------------------------------------------------------------


def trained(stages, agent="gbdqn-reuse", **values):
    """A reuse agent with so many stages on its shelf; the newest won every trial."""
    agent = agent_of(agent, drift_signal="schedule", **values)
    for k in range(stages):
        for _ in range(4):
            play(agent, 10.0)
        feed(agent, 30, seed=k)
        agent.on_drift("drift")
        while agent.on_trial:
            play(agent, 10.0)
    return agent


def test_the_first_stage_has_no_competitor():
    agent = trained(0)
    feed(agent, 30)
    agent.on_drift("drift")
    assert not agent.on_trial and agent.shelf.tolist() == [0]


@pytest.mark.parametrize("agent", ["gbdqn-reuse", "dqn-reuse"])
@pytest.mark.parametrize("winner", [0, 1, 2])
def test_each_stage_plays_one_episode_and_the_best_one_continues(agent, winner):
    agent = trained(2, agent)
    feed(agent, 30, seed=9)
    agent.on_drift("drift")
    assert agent.shelf.tolist() == [0, 1, 2] and agent.on_trial
    stages = agent.ensemble.staged_q(states())
    for stage in (2, 1, 0):
        assert [agent.act(s) for s in states()] == stages[stage].argmax(-1).tolist()
        play(agent, 20.0 if stage == winner else 10.0)
    assert not agent.on_trial
    np.testing.assert_allclose(agent.q(states()), stages[winner], rtol=1e-3, atol=1e-4)
    assert agent.shelf.tolist() == [stage for stage in (0, 1, 2) if stage == 2 or stage != winner]


def test_among_equal_stages_the_newest_continues():
    agent = trained(2)
    feed(agent, 30, seed=9)
    before = agent.q(states())
    agent.on_drift("reset")
    for _ in range(3):
        play(agent, 10.0)
    np.testing.assert_allclose(agent.q(states()), before, rtol=1e-4, atol=1e-5)
    assert agent.shelf.tolist() == [0, 1, 2]


def test_the_booster_on_an_older_winner_learns_at_the_changed_step_size():
    agent = trained(2, lr=0.01, lr_factor=5.0)
    agent.on_drift("drift")
    for total in (1.0, 1.0, 9.0):
        play(agent, total)
    assert not agent.on_trial and agent.adam.lr == 0.05


def test_the_shelf_holds_only_the_last_stages():
    agent = trained(SHELF + 2)
    assert agent.shelf.tolist() == [2, 3, 4] and len(agent.ensemble) == 5


def test_the_return_of_a_stage_is_not_charted():
    """Several policies play, so these returns say nothing about the physics; a model's error does,
    and so does |δ|, whoever plays.
    """
    agent = trained(2)
    feed(agent, 10)
    agent.on_drift("drift")
    charted = []
    agent.detector.update = lambda replay, start, total, td_error: charted.append(total)
    for total in (1.0, 2.0, 3.0, 14.0, 5.0, 16.0, 7.0):  # three trials, then base and learner
        play(agent, total)
    np.testing.assert_array_equal(charted, [np.nan] * 4 + [5.0, np.nan, 7.0])
    assert agent.recent.tolist() == [5.0, 7.0]
    detector = Detector("return", 1.0, None)
    detector.update(agent.replay, 0, np.nan, 0.5)
    assert detector.chart.n == -REFERENCE
    model = SimpleNamespace(update=lambda replay, index: 0.5)
    detector = Detector("model", 1.0, model)
    detector.update(agent.replay, 0, np.nan, np.nan)
    assert detector.chart.n == 1 - REFERENCE


def on_probation(agent="gbdqn-reuse"):
    """A reuse agent after its first drift; its level before was 10, its worst return 0."""
    agent = agent_of(agent, drift_signal="schedule", capacity=1000)
    for total in (0.0, *[10.0] * WINDOW):
        play(agent, total)
    feed(agent, 60)
    agent.on_drift("drift")
    return agent


@pytest.mark.parametrize("agent", ["gbdqn-reuse", "dqn-reuse"])
def test_on_probation_the_learner_and_its_base_play_in_turn(agent):
    agent = on_probation(agent)
    feed(agent, 60, seed=1)
    for _ in range(40):
        agent.learn()
    base, learner = agent.ensemble.staged_q(states())[0], agent.q(states())
    assert (base.argmax(-1) != learner.argmax(-1)).any()
    for k in range(4):
        if k % 2 == 0:
            assert [agent.act(s) for s in states()] == base.argmax(-1).tolist()
        greedy = [agent.act(s, greedy=True) for s in states()]
        assert greedy == learner.argmax(-1).tolist(), "an evaluation is of the learner"
        assert agent._playing() == (None if k % 2 else 0)
        play(agent, 10.0)


@pytest.mark.parametrize(
    ("base", "learner", "turns"),
    [
        ([8.0] * 9, [8.0] * 9, 2 * TURNS),  # as good is good enough
        ([8.0] * 9, [1.0] * 2 + [8.0] * 7, 2 * TURNS + 4),  # the last five count
        ([8.0] * 9, [20.0] * 9, 2 * TURNS),  # five are needed
        ([5.0] + [0.0] * 9, [9.0] * 9, 2 * TURNS),  # the midpoint is good enough
        ([4.0] * 9, [0.0] * 9, 1),  # the base has been useless since the change
    ],
)
def test_when_probation_ends(base, learner, turns):
    agent, played = on_probation(), 0
    for pair in zip(base, learner, strict=False):
        for total in pair:
            if agent.on_probation:
                play(agent, total)
                played += 1
    assert not agent.on_probation and played == turns


def test_after_a_trial_the_winner_is_the_base():
    agent = trained(2)
    agent.on_drift("drift")
    for total in (1.0, 9.0, 1.0):
        play(agent, total)
    assert agent.on_probation and agent.base == agent._playing() == 1


@pytest.mark.parametrize(("later", "again"), [(-200.0, True), (-100.0, False)])
def test_without_recovery_the_stages_compete_again(later, again):
    """The level before the drift is −100, the floor −200, so the threshold is −150."""
    agent = agent_of("gbdqn-reuse", drift_signal="schedule", capacity=2000)
    for _ in range(WINDOW):
        play(agent, -100.0)
    agent.on_drift("drift")
    for _ in range(2):  # its base, which then has no more turns, and the learner
        play(agent, -200.0)
    for _ in range(PATIENCE - 2):
        play(agent, later)
    assert len(agent.shelf) == 1
    play(agent, later)
    assert (len(agent.shelf) == 2, agent.on_trial) == (again, again)
    assert len(agent.replay) == 5 * (PATIENCE + 1), "data of the current physics stay"


def test_the_stages_compete_again_at_any_time_after_a_late_fall():
    """After 80 good returns the mean of ten is below −150 with the sixth bad one."""
    agent = agent_of("gbdqn-reuse", drift_signal="schedule", capacity=2000)
    for _ in range(WINDOW):
        play(agent, -100.0)
    agent.on_drift("drift")
    for total in [-200.0] * 2 + [-100.0] * 80 + [-200.0] * 5:
        play(agent, total)
    assert len(agent.shelf) == 1
    play(agent, -200.0)
    assert len(agent.shelf) == 2 and agent.on_trial


def test_an_unrecovered_level_does_not_become_the_new_target():
    agent = agent_of("gbdqn-reuse", drift_signal="schedule", capacity=2000)
    for total in [-100.0] * WINDOW + [-200.0]:
        play(agent, total)
    agent.on_drift("drift")
    before = agent.before
    for _ in range(WINDOW):
        play(agent, -200.0)
    agent.on_drift("reset")
    assert agent.before == before > -200.0


# --- every agent resumes under every signal -------------------------------------------------------

SIGNALS = (
    dict(drift_signal="schedule"),
    dict(drift_signal=[3, 6]),
    *(dict(drift_signal="detector", symptom=symptom) for symptom in SLACK),
)
COMBINATIONS = [  # every pair of agent, signal and part occurs
    (agent, signal, (i + j) % 2 / 2)
    for i, agent in enumerate(sorted(AGENTS))
    for j, signal in enumerate(SIGNALS)
]


@pytest.mark.parametrize(("agent", "signal", "part"), COMBINATIONS)
def test_every_agent_resumes_identically_under_every_signal(tmp_path, agent, signal, part):
    values = dict(keep_data=part, epsilon_restart=0.3, lr_factor=2.0) | signal
    config = Config(agent=agent, alarm_level=0.5, **DRIFTING | values)
    original, records = make_agent(config), []
    for record in run(config, original):
        records.append(repr(record))
        if record["episode"] == 6:
            checkpoint.save(tmp_path / "half", original, 7)
    again = make_agent(config)
    assert checkpoint.load(tmp_path / "half", again) == 7
    assert [repr(record) for record in run(config, again, 7)] == records[7:]
    assert state_bytes(again) == state_bytes(original)
