"""Notebook 2: the agent, and one perfect booster."""

import numpy as np
from forty_lines import GAMMA, LEFT, RIGHT, ROOMS, Boosted, step
from lesson import corridor

from . import Exercise


def boost(frozen, goal, alpha):
    h = np.zeros((ROOMS, 2))
    for room in range(ROOMS):
        for action in (LEFT, RIGHT):
            if room != goal:
                room2, y, terminated = step(room, action, goal)
                if not terminated:
                    y += GAMMA * frozen[room2].max()
                h[room, action] = y - frozen[room, action]
    return frozen + alpha * h


# The agent's likely mistakes


class NoLearning(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        pass


class NoMask(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        super().learn(room, action, reward, room2, False, rate)


class NoGamma(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        y = reward if terminated else reward + self.q()[room2].max()
        super().learn(room, action, y, room2, True, rate)


class ResidualOfTheSum(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        y = reward if terminated else reward + GAMMA * self.q()[room2].max()
        residual = y - self.frozen[room, action] - self.h[room, action]
        self.h[room, action] += rate * (residual - self.h[room, action])


class ErrorOfQ(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        y = reward if terminated else reward + GAMMA * self.q()[room2].max()
        self.h[room, action] += rate * (y - self.q()[room, action])


class ErrorOfQTwice(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        y = reward if terminated else reward + GAMMA * self.q()[room2].max()
        residual = y - self.q()[room, action]
        self.h[room, action] += rate * (residual - self.h[room, action])


class WithoutH(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        y = reward if terminated else reward + GAMMA * self.q()[room2].max()
        self.h[room, action] += rate * (y - self.frozen[room, action])


class NoFrozen(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        y = reward if terminated else reward + GAMMA * self.q()[room2].max()
        self.h[room, action] += rate * (y - self.h[room, action])


class FrozenTarget(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        y = reward if terminated else reward + GAMMA * self.frozen[room2].max()
        super().learn(room, action, y, room2, True, rate)


class LiveTarget(Boosted):
    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        q_next = (self.frozen + self.h)[room2]
        y = reward if terminated else reward + GAMMA * q_next.max()
        super().learn(room, action, y, room2, True, rate)


class AlwaysLive(Boosted):
    def q(self):
        return self.frozen + self.h


class QInPlace(Boosted):
    def q(self):
        if self.live:
            self.frozen += self.h
        return self.frozen


class NoDrift(Boosted):
    def drift(self):
        pass


class DriftForgetsH(Boosted):
    def drift(self):
        self.h = np.zeros((ROOMS, 2))


class DriftForgetsFrozen(Boosted):
    def drift(self):
        self.frozen, self.h = self.h, np.zeros((ROOMS, 2))


class DriftByQ(Boosted):
    def drift(self):
        self.frozen, self.h = self.q(), np.zeros((ROOMS, 2))


class DriftKeepsH(Boosted):
    def drift(self):
        self.frozen = self.frozen + self.h


def lived(attempt, *calls):
    """An entry of a table after some calls; the last of them names the entry."""
    agent = attempt()
    if agent is None or agent is ... or agent.q() is None:
        return None
    for name, *arguments in calls[:-1]:
        if name == "live":
            agent.live = arguments[0]
        else:
            getattr(agent, name)(*arguments)
    table, room, action = calls[-1]
    return (agent.q() if table == "q()" else getattr(agent, table))[room, action]


def told(_, *calls):
    """Those calls as a reader would write them."""
    *before, (table, room, action) = calls
    return f"After {'; '.join(map(line, before))}: {table}[{room}, {WAYS[action]}]"


def line(call):
    name, *arguments = call
    if name == "learn":
        arguments[1] = WAYS[arguments[1]]
    text = ", ".join(map(str, arguments))
    return f"live = {text}" if name == "live" else f"{name}({text})"


WAYS = "LEFT", "RIGHT"
END = "learn", 8, RIGHT, -1.0, 9, True
IN_9 = [("learn", 9, LEFT, -1.0, 8, False), ("learn", 9, RIGHT, -1.0, 9, False)]
IN_8 = ("learn", 8, LEFT, -1.0, 7, False), END
BEFORE = "learn", 7, RIGHT, -1.0, 8, False
FROZEN = "live", False
Q_END, Q_BEFORE = ("q()", 8, RIGHT), ("q()", 7, RIGHT)
H_END, H_BEFORE = ("h", 8, RIGHT), ("h", 7, RIGHT)


# The perfect booster's


def no_mask(frozen, goal, alpha):
    """Like boost, but for a world without an end: the goal leads to itself for 0."""
    h = np.zeros((ROOMS, 2))
    for room, action in np.ndindex(ROOMS, 2):
        if room != goal:
            room2, reward, _ = step(room, action, goal)
            y = reward + GAMMA * frozen[room2].max()
            h[room, action] = y - frozen[room, action]
    return frozen + alpha * h


def at_the_goal_too(frozen, goal, alpha):
    Q = boost(frozen, goal, alpha)
    for action in (LEFT, RIGHT):
        room2, y, terminated = step(goal, action, goal)
        y += 0 if terminated else GAMMA * frozen[room2].max()
        Q[goal, action] += alpha * (y - frozen[goal, action])
    return Q


def in_place(frozen, goal, alpha):
    Q = frozen.copy()
    for room, action in np.ndindex(ROOMS, 2):
        if room != goal:
            Q[room, action] = boost(Q, goal, alpha)[room, action]
    return Q


def h_is_y(frozen, goal, alpha):
    h = boost(frozen, goal, 1)
    h[goal] = 0
    return frozen + alpha * h


def same_action(frozen, goal, alpha):
    h = np.zeros((ROOMS, 2))
    for room, action in np.ndindex(ROOMS, 2):
        if room != goal:
            room2, y, terminated = step(room, action, goal)
            y += 0 if terminated else GAMMA * frozen[room2, action]
            h[room, action] = y - frozen[room, action]
    return frozen + alpha * h


def boosted(attempt, boosts, goal, alpha, room, action):
    """An entry of the old Q* after some boosts."""
    Q = corridor(9).q_star()
    for _ in range(boosts):
        Q = attempt(Q, goal, alpha)
        if Q is None or Q is ...:
            return None
    return Q[room, action]


def boosts_told(_, boosts, goal, alpha, room, action):
    case = f"{boosts} × boost with goal = {goal}, alpha = {alpha:g}"
    return f"From the old Q*, {case}: Q[{room}, {WAYS[action]}]"


EXERCISES = [
    Exercise(
        "Boosted",
        "begin with q(): frozen + h if live, else frozen. In learn, compute y as in "
        "notebook 1 with q()[room2]; h moves towards y − frozen by the rate.",
        Boosted,
        {
            "q() is right; learn does nothing yet.": NoLearning,
            "q() and learn are right; drift does nothing yet.": NoDrift,
            "At the end, y is the reward alone.": NoMask,
            "γ is missing in the target.": NoGamma,
            "The residual is y − (frozen + h); it should be y − frozen.": (
                ResidualOfTheSum
            ),
            "You subtract q(). When live is False that leaves h out. Subtract frozen "
            "and h.": ErrorOfQ,
            "The residual is y − q(), and h is subtracted again; it should be "
            "y − frozen.": ErrorOfQTwice,
            "h moves by rate · residual; subtract h from the residual first.": WithoutH,
            "h learns y itself; it should learn y − frozen.": NoFrozen,
            "The target is made from frozen; if live, it is made from frozen + h.": (
                FrozenTarget
            ),
            "The target is made from frozen + h, also when live is False.": LiveTarget,
            "q() adds h even when live is False.": AlwaysLive,
            "q() changes frozen, at every call. Return a new table.": QInPlace,
            "drift forgets to add h: what was learnt is lost.": DriftForgetsH,
            "drift puts h in the place of frozen: what was frozen before is lost.": (
                DriftForgetsFrozen
            ),
            "drift adds h but keeps it too: now h counts twice.": DriftKeepsH,
            "drift freezes q(). When live is False that leaves h out: add h.": DriftByQ,
        },
        [
            (END, Q_END),
            (END, END, Q_END),
            (*IN_9, END, Q_END),
            (BEFORE, BEFORE, Q_BEFORE),
            (*IN_8, BEFORE, Q_BEFORE),
            (END, ("drift",), Q_END),
            (END, ("drift",), END, Q_END),
            (END, ("drift",), END, H_END),
            (END, ("drift",), END, ("drift",), Q_END),
            (*IN_8, ("drift",), *IN_8, BEFORE, Q_BEFORE),
            (END, FROZEN, Q_END),
            (END, ("drift",), FROZEN, END, END, H_END),
            (*IN_8, ("drift",), FROZEN, *IN_8, BEFORE, H_BEFORE),
            (END, ("drift",), FROZEN, END, ("drift",), Q_END),
        ],
        lived,
        told,
    ),
    Exercise(
        "boost",
        "h[room, action] is y − frozen[room, action], with y as in notebook 1 and "
        "frozen[room2] in it; the goal's row of h is 0. Return frozen + alpha * h.",
        boost,
        {
            "A step into the goal is the end: there y is the reward alone.": no_mask,
            "The goal's own row changes; the episode is over there.": at_the_goal_too,
            "y is made from new values; it should be made from frozen only.": in_place,
            "h is y; it should be y − frozen.": h_is_y,
            "In the next room the best action counts, not the same one.": same_action,
            "The goal is written in as 0; use goal.": (
                lambda frozen, goal, alpha: boost(frozen, 0, alpha)
            ),
            "alpha is not used.": lambda frozen, goal, alpha: boost(frozen, goal, 1),
            "That is h alone; it must be added to frozen.": (
                lambda frozen, goal, alpha: boost(frozen, goal, alpha) - frozen
            ),
        },
        [
            (1, 0, 1.0, 1, LEFT),
            (1, 0, 0.5, 1, LEFT),
            (1, 0, 1.0, 9, RIGHT),
            (1, 0, 1.0, 5, LEFT),
            (1, 0, 1.0, 0, LEFT),
            (1, 0, 1.0, 0, RIGHT),
            (2, 0, 1.0, 1, LEFT),
            (2, 0, 1.0, 2, LEFT),
            (2, 0, 1.0, 1, RIGHT),
            (1, 0, 0.5, 2, LEFT),
            (1, 3, 1.0, 4, LEFT),
        ],
        boosted,
        boosts_told,
    ),
]
