# %% [markdown]
# # 4 · Boosting the residual
#
# **Eqs. 1–9.** DQN has one network, and when the world changes that network must unlearn before it can learn. GB-DQN
# freezes it and lets a *second* network learn only what the first one now gets wrong. This is gradient boosting, with
# the Bellman residual in the place of the label's. After this notebook you can derive each step of it, and you know
# the three places where the printed equations do not give what the text says.
#
# *Before:* notebook 3 (targets). *Needs:* sums, derivatives. *Time:* a quarter of an hour.

# %%
import numpy as np
from lesson import source

from gbdqn_ref.boosting import Ensemble
from gbdqn_ref.nn import MLP

rng = np.random.default_rng(0)

# %% [markdown]
# ## Eq. 1 · The ensemble is a sum
#
# $$Q_m(s, a) \;=\; \sum_{j=1}^{m} \alpha_j\, h_j(s, a) \;=\; Q_{m-1}(s, a) + \alpha_m h_m(s, a) \tag{1}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $h_j$ | `net.forward(theta, x)` | (B, A) | booster number j, a network like DQN's |
# | $\alpha_j$ | `ensemble.alpha[j]` | (m,) | its weight |
# | $\theta_j$ | `ensemble.theta[j]` | (m, P) | its parameters, one row of a stack |
# | $Q_m$ | `ensemble.q(x)` | (B, A) | the answer |
#
# All boosters are frozen: the only thing one can do with an ensemble is ask it, or add one more.

# %%
source(Ensemble)

# %% [markdown]
# The same, naively: one booster after the other, in a loop.

# %%
net = MLP((2, 16, 3))  # two numbers in, three actions out
ensemble = Ensemble(net)
for alpha in (1.0, 0.5, 0.1):
    ensemble.add(net.init(rng), alpha)
x = rng.normal(size=(4, 2)).astype(np.float32)

q = np.zeros((4, 3))
for theta, alpha in zip(ensemble.theta, ensemble.alpha, strict=True):
    h, _ = net.forward(theta, x)
    q = q + alpha * h

assert np.allclose(q, ensemble.q(x), atol=1e-6)
q.round(3)

# %% [markdown]
# > **Predict, then run.** What does an ensemble without any booster answer? Write the number down before you run the
# > next cell.

# %%
Ensemble(net).q(x)[0]

# %% [markdown]
# Zero, for every action in every state: an empty sum. Algorithm 1 starts there, and notebook 6 shows what that costs.
#
# **Exercise 1.** `staged_q` gives $Q_1, Q_2, \dots, Q_m$ at once. Recover $\alpha_2 h_2(x)$ from it, without asking
# any network.

# %% tags=["solution"] jupyter={"source_hidden": true}
stages = ensemble.staged_q(x)
second = stages[1] - stages[0]
assert np.allclose(second, ensemble.terms(x)[1], atol=1e-6)
