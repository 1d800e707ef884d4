"""One table of agents: to add one, write its class and one row."""

from collections.abc import Callable
from typing import Any, NamedTuple

from .baselines import EnsembleDQN, FrozenDQN, Random, ResetDQN, sliding_dqn
from .dqn import DQN
from .gbdqn import GBDQN

# Okabe and Ito's colours, which a colour-blind reader can tell apart
OKABE_ITO = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK = OKABE_ITO


class Agent(NamedTuple):
    """How an agent is made and shown, and what it makes of the settings.

    `make(state_dim, n_actions, config, rng)` is its class. `own` are its values of settings that
    are None. `reads` are the settings that it alone reads, beside those of every DQN.
    """

    make: Callable
    label: str
    colour: str
    mark: str
    line: str = "-"
    own: dict[str, Any] = {}
    reads: tuple[str, ...] = ()


OWN: dict[str, Any] = {"replay": "proportional"}  # where an agent has no value of its own
RECENCY: dict[str, Any] = {"replay": "recency"}
BOOSTING = ("target", "alpha", "loss_on", "zero_output")
AGENTS = {
    "gbdqn": Agent(GBDQN, "GB-DQN", BLUE, "o", own=RECENCY, reads=BOOSTING),
    "dqn": Agent(DQN, "DQN", VERMILION, "^"),
    "ensemble": Agent(EnsembleDQN, "Ensemble-DQN", GREEN, "s", reads=("members", "bootstrap")),
    "reset": Agent(ResetDQN, "Reset-DQN", PURPLE, "v"),
    "sliding": Agent(sliding_dqn, "Sliding-DQN", ORANGE, "D", reads=("window",)),
    "frozen": Agent(FrozenDQN, "Frozen DQN", SKY, "P"),
    "random": Agent(Random, "Random", BLACK, "X"),
    "dqn-recency": Agent(DQN, "DQN-recency", VERMILION, "<", "--", own=RECENCY),
    "gbdqn-per": Agent(GBDQN, "GB-DQN-PER", BLUE, ">", "--", reads=BOOSTING),
}
