"""GB-DQN in forty lines, on ten rooms whose goal moves: the solution of notebook 2."""

import numpy as np

ROOMS, GAMMA = 10, 0.9
LEFT, RIGHT = 0, 1


def step(room, action, goal):
    """Walk one room: (next room, reward, whether that is the end)."""
    room2 = room + 1 if action == RIGHT else room - 1
    room2 = min(max(room2, 0), ROOMS - 1)  # there is a wall at either end
    return room2, -1.0, room2 == goal


class Boosted:
    """Q = frozen + h. Only h learns; at a drift it joins the frozen part."""

    def __init__(self, live=True):
        self.frozen, self.h = np.zeros((ROOMS, 2)), np.zeros((ROOMS, 2))
        self.live = live

    def q(self):
        """The table it acts by and bootstraps with: with h if live, else without."""
        return self.frozen + self.h if self.live else self.frozen

    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        """With residual = y − frozen: h += rate * (residual − h) at [room, action]."""
        y = reward if terminated else reward + GAMMA * self.q()[room2].max()
        residual = y - self.frozen[room, action]
        self.h[room, action] += rate * (residual - self.h[room, action])

    def drift(self):
        """Freeze what is known: h joins the frozen part, and a new h begins at 0."""
        self.frozen = self.frozen + self.h
        self.h = np.zeros((ROOMS, 2))


def train(agent, goal, episodes, rng):
    """Walk and learn for some episodes of at most 100 steps, from random rooms."""
    for _ in range(episodes):
        room = rng.choice([r for r in range(ROOMS) if r != goal])
        for _ in range(100):
            action = agent.q()[room].argmax()
            if rng.random() < 0.2:
                action = rng.integers(2)
            room2, reward, terminated = step(room, action, goal)
            agent.learn(room, action, reward, room2, terminated)
            room = room2
            if terminated:
                break


if __name__ == "__main__":
    for name in ("go on", "freeze", "freeze, to the letter"):
        agent, rng = Boosted(), np.random.default_rng(0)
        train(agent, 9, 300, rng)
        if name != "go on":
            agent.drift()
        agent.live = name != "freeze, to the letter"
        train(agent, 0, 300, rng)
        turned = (agent.q()[1:, LEFT] > agent.q()[1:, RIGHT]).sum()
        print(f"{name}: {turned} of 9 rooms have turned around")
