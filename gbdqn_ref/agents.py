"""One table of agents: to add one, write its class and one row."""

from collections.abc import Callable
from typing import Any, NamedTuple

from .baselines import EnsembleDQN, FrozenDQN, Random, ResetDQN, sliding_dqn
from .dqn import DQN
from .gbdqn import GBDQN
from .reuse import ReuseGBDQN

# Okabe and Ito's colours, which a colour-blind reader can tell apart
OKABE_ITO = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK = OKABE_ITO


class Agent(NamedTuple):
    """How an agent is built and drawn, and its values of the settings.

    `make(state_dim, n_actions, config, rng)` builds it. `own` replaces settings that are None.
    `reads` names the settings that it reads beyond those of every DQN.
    """

    make: Callable
    label: str
    colour: str
    mark: str
    line: str = "-"
    own: dict[str, Any] = {}
    reads: tuple[str, ...] = ()


OWN: dict[str, Any] = dict(  # the values of an agent whose row has none
    replay="proportional",
    alpha=0.1,
    zero_output=True,
    warm_start=False,
    keep_data=1.0,
    keep_adam=True,
    drift_signal="schedule",
)
RECENCY: dict[str, Any] = dict(replay="recency")
# What to keep at a drift, and how to detect one, is our question, not the paper's (D22).
REUSE: dict[str, Any] = dict(alpha=1.0, keep_data=0.0, keep_adam=False, drift_signal="detector")
TWIN: dict[str, Any] = REUSE | dict(warm_start=True, zero_output=False)
BOOSTING = ("target", "alpha", "loss_on", "zero_output", "warm_start")
AGENTS = {
    "gbdqn": Agent(GBDQN, "GB-DQN", BLUE, "o", own=RECENCY, reads=BOOSTING),
    "dqn": Agent(DQN, "DQN", VERMILION, "^"),
    "ensemble": Agent(EnsembleDQN, "Ensemble-DQN", GREEN, "s", reads=("members", "bootstrap")),
    "reset": Agent(ResetDQN, "Reset-DQN", PURPLE, "v", own=dict(keep_adam=False)),
    "sliding": Agent(sliding_dqn, "Sliding-DQN", ORANGE, "D", reads=("window",)),
    "frozen": Agent(FrozenDQN, "Frozen DQN", SKY, "P"),
    "random": Agent(Random, "Random", BLACK, "X"),
    "dqn-recency": Agent(DQN, "DQN-recency", VERMILION, "<", "--", own=RECENCY),
    "gbdqn-per": Agent(GBDQN, "GB-DQN-PER", BLUE, ">", "--", reads=BOOSTING),
    "gbdqn-reuse": Agent(ReuseGBDQN, "GB-DQN-reuse", BLUE, "*", "-.", REUSE, BOOSTING),
    "dqn-reuse": Agent(ReuseGBDQN, "DQN-reuse", VERMILION, "p", "-.", TWIN, BOOSTING),
}
