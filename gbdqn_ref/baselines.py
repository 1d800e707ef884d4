"""What GB-DQN is compared with beside DQN: the random policy."""


class Random:
    """Every action equally likely, whatever the state: the level at which nothing has been learnt."""

    def __init__(self, n_actions, rng):
        self.n_actions, self.rng = n_actions, rng

    def act(self, s, greedy=False):
        return int(self.rng.integers(self.n_actions))
