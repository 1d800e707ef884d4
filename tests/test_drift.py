"""The wrapper that applies a schedule to a Gymnasium environment."""

import json
import warnings

import gymnasium
import pytest
from gymnasium.envs.classic_control import CartPoleEnv
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

from gbdqn_ref import UsageError, drift
from gbdqn_ref.drift import DriftWrapper, make
from gbdqn_ref.schedule import stock

TWO = [
    {"episode": 2, "gravity": 1.5},
    {"episode": 5, "gravity": 1.5, "force": 0.5},
    {"episode": 6, "reset": True},
]
KNOWN_WARNINGS = "different from the unwrapped version|space (minimum|maximum) value is -?infinity"
SHORT = [{"episode": 1, "gravity": 1.5}, {"episode": 3, "reset": True}]
both = pytest.mark.parametrize("schedule", [[], SHORT], ids=["stock", "drifting"])
named = pytest.mark.parametrize("name", drift.ENVIRONMENTS)


@st.composite
def schedules(draw, name):
    episodes = draw(st.lists(st.integers(0, 60), unique=True, max_size=6).map(sorted))
    some = st.dictionaries(st.sampled_from(sorted(stock(name))), st.floats(0.01, 100), min_size=1)
    return [{"episode": k} | draw(st.one_of(some, st.just({"reset": True}))) for k in episodes]


def factors(entry, name="cartpole"):
    """Every factor of an entry's regime."""
    return stock(name) | {key: entry[key] for key in entry.keys() - {"episode", "reset"}}


@named
@both
def test_gymnasiums_checker_finds_no_fault(name, schedule):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", f"(?s).*({KNOWN_WARNINGS})", UserWarning)
        # MuJoCo can draw only on a display
        check_env(make(name, schedule), skip_render_check=name == "hopper")


@named
@both
def test_a_spec_rebuilds_the_wrapper_with_its_schedule(name, schedule):
    spec = make(name, schedule).spec
    for spec_again in (spec, EnvSpec.from_json(spec.to_json())):
        env, again = make(name, schedule), gymnasium.make(spec_again)
        assert isinstance(again, DriftWrapper) and again.regimes == env.regimes
        assert again.spec.max_episode_steps == env.spec.max_episode_steps
        for _ in range(4):
            assert again.reset(seed=3)[1] == env.reset(seed=3)[1]
            assert again.step(1)[0].tolist() == env.step(1)[0].tolist()


def test_episodes_count_from_0():
    env = make("cartpole", TWO)
    assert [env.reset()[1]["regime"] for _ in range(8)] == [0, 0, 1, 1, 1, 2, 3, 3]


def test_only_the_first_episode_of_a_regime_has_the_event():
    env = make("cartpole", TWO)
    events = [env.reset()[1]["event"] for _ in range(8)]
    assert events == [None, None, "drift", None, None, "drift", "reset", None]


def test_every_reset_and_step_reports_regime_factors_and_event():
    env = make("cartpole", TWO)
    for episode in range(7):
        _, info = env.reset(seed=0)
        expected = {key: info[key] for key in ("regime", "factors", "event")}
        assert set(info["factors"]) == set(stock("cartpole"))
        for _ in range(3):
            assert env.step(0)[4] == expected, episode


def test_a_drift_is_applied_before_the_reset_of_its_episode():
    class Probe(CartPoleEnv):
        seen = []

        def reset(self, **kwargs):
            self.seen.append(self.gravity / 9.8)
            return super().reset(**kwargs)

    probe = Probe()
    probe.spec = gymnasium.spec("CartPole-v1")
    env = DriftWrapper(probe, TWO)
    for _ in range(7):
        env.reset()
    assert Probe.seen == pytest.approx([1, 1, 1.5, 1.5, 1.5, 1.5, 1])


def test_a_reset_entry_restores_the_stock_physics():
    env = make("cartpole", TWO)
    gravity = [env.reset() and env.unwrapped.gravity for _ in range(7)]
    assert gravity[5] == 9.8 * 1.5 and gravity[6] == 9.8
    assert env.unwrapped.force_mag == 10.0


def test_a_factor_that_an_entry_does_not_name_is_1_again():
    """Catches regimes that build on the one before."""
    env = make("cartpole", [{"episode": 1, "gravity": 2.0}, {"episode": 2, "length": 3.0}])
    seen = [env.reset()[1]["factors"] for _ in range(3)]
    assert seen == [factors(entry) for entry in ({}, {"gravity": 2.0}, {"length": 3.0})]
    assert (env.unwrapped.gravity, env.unwrapped.length) == (9.8, 1.5)


def test_the_physics_do_not_change_within_an_episode():
    env = make("cartpole", [{"episode": 1, "gravity": 2.0}])
    env.reset()
    for _ in range(3):
        env.step(0)
        assert env.unwrapped.gravity == 9.8


def test_options_jump_to_an_episode_and_counting_continues_there():
    env = make("cartpole", TWO)
    jumps = [{"episode": 5}, None, {"episode": 2}, {"episode": 0}, {}]
    infos = [env.reset(options=options)[1] for options in jumps]
    assert [info["regime"] for info in infos] == [2, 3, 1, 0, 0]
    assert [info["event"] for info in infos] == ["drift", "reset", "drift", None, None]
    assert env.unwrapped.gravity == 9.8


def test_other_options_reach_the_environment_and_the_callers_dict_is_unchanged():
    options = {"episode": 2, "low": 0.04, "high": 0.05}
    s, info = make("cartpole", TWO).reset(seed=0, options=options)
    assert (s >= 0.04).all() and info["regime"] == 1
    assert options == {"episode": 2, "low": 0.04, "high": 0.05}


@pytest.mark.parametrize("episode", [-1, "2", None, 1.5])
def test_an_invalid_episode_is_refused(episode):
    with pytest.raises(UsageError, match=f"episode must be .*, not {episode!r}$"):
        make("cartpole", TWO).reset(options={"episode": episode})


def test_an_entry_at_episode_0_is_regime_0_without_an_event():
    env = make("cartpole", [{"episode": 0, "gravity": 2.0}, {"episode": 1, "gravity": 1.5}])
    infos = [env.reset()[1] for _ in range(3)]
    found = [(info["regime"], info["event"]) for info in infos]
    assert found == [(0, None), (1, "drift"), (1, None)]
    assert infos[0]["factors"]["gravity"] == 2.0


def test_info_is_a_fresh_dict_each_time():
    env = make("cartpole", TWO)
    for _ in range(3):
        _, info = env.reset()
        _, _, _, _, after = env.step(0)
        for mine in (info, after):
            mine["factors"]["gravity"], mine["regime"] = 99.0, 99  # catches a dict handed out twice
    _, info = env.reset(options={"episode": 3})
    assert info["factors"]["gravity"] == 1.5 == env.unwrapped.gravity / 9.8 and info["regime"] == 1


def test_the_wrapper_copies_its_schedule():
    schedule = [{"episode": 1, "gravity": 2.0}]
    env = make("cartpole", schedule)
    for _ in range(3):
        env.reset()
    assert schedule == [{"episode": 1, "gravity": 2.0}]
    schedule[0]["gravity"] = 9.0
    assert env.reset()[1]["factors"]["gravity"] == 2.0


def test_observations_rewards_and_time_limit_are_the_stock_ones():
    env, stock = make("cartpole", TWO), gymnasium.make("CartPole-v1")
    assert env.reset(seed=7)[0].tolist() == stock.reset(seed=7)[0].tolist()
    outcome, expected = env.step(1), stock.step(1)
    assert outcome[0].tolist() == expected[0].tolist() and outcome[1:4] == expected[1:4]
    assert env.spec.max_episode_steps == 500 and env.observation_space == stock.observation_space


@named
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_the_regime_is_the_last_entry_that_has_begun(name, data):
    schedule = data.draw(schedules(name))
    episode = data.draw(st.integers(0, 70))
    begun = [entry for entry in schedule if entry["episode"] <= episode]
    _, info = make(name, schedule).reset(options={"episode": episode})
    assert info["factors"] == factors(begun[-1] if begun else {}, name)
    stock_first = not schedule or schedule[0]["episode"] > 0
    assert info["regime"] == max(len(begun) - 1 + stock_first, 0)
    starts = begun and episode and begun[-1]["episode"] == episode
    kind = starts and ("reset" if "reset" in begun[-1] else "drift")
    assert info["event"] == (kind or None)


@named
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_counting_and_jumping_agree(name, data):
    schedule = data.draw(schedules(name))
    counting, jumping = make(name, schedule), make(name, json.loads(json.dumps(schedule)))
    for episode in range(12):
        _, info = jumping.reset(seed=episode, options={"episode": episode})
        assert counting.reset(seed=episode)[1] == info


@pytest.mark.parametrize("id", ["Pendulum-v1", "Acrobot-v1"])
def test_an_unsupported_environment_is_refused(id):
    with pytest.raises(
        UsageError, match=r"unknown environment .*cartpole, mountaincar, acrobot, hopper"
    ):
        DriftWrapper(gymnasium.make(id), [])


def test_an_environment_without_a_spec_is_refused():
    with pytest.raises(UsageError, match="environment"):
        DriftWrapper(CartPoleEnv())


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(
        UsageError,
        match="unknown environment 'cart'; choose one of cartpole, mountaincar, acrobot, hopper",
    ):
        make("cart")
