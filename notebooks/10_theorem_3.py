# %% [markdown]
# # 10 · Theorem 3: a sum of priorities
#
# You will be able to say why a sum of two priorities does not draw as their product
# does, and what a larger buffer does to the sum.
#
# *Time: 17 minutes. Needs: notebook 6; what a probability distribution and a variance
# are. With the paper open: Theorem 3 and its proof sketch; Eqs. 10–11.*
#
# **How to read this with the paper open.** Put the two formulas of the theorem side by
# side, $P^*(i)$ and $P(i)$. One has a product, the other a sum. Then look in the sketch
# for the line that turns the sum into the product.

# %% [markdown]
# ## Theorem 3 · what it says
#
# The theorem in plain words. A replay should draw transitions that are both surprising
# and recent. So the **ideal** draws in proportion to the *product* of |δ| and recency.
# The rule of Eq. 10 draws in proportion to a *sum* of the two, mixed by β. The theorem
# says that with a large buffer the rule tends to the ideal, and that no other mixture
# has a smaller **variance**, which is how far its estimates scatter.
#
# $$P^*(i) \propto |\delta_i|\; e^{-\alpha(T-t_i)} \qquad \text{against} \qquad
#   P(i) = \frac{p_i}{\sum_j p_j}, \quad
#   p_i = \beta\,|\delta_i| + (1-\beta)\, e^{-\alpha(T-t_i)}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\lvert\delta_i\rvert^\gamma$ | `td_priority(delta, 0, 1)` | (N,) | here with exponent γ = 1 and no offset |
# | $e^{-\alpha(T-t_i)}$ | `time_priority(age, rate)` | (N,) | recency: 1 for the newest |
# | β | `mix` | scalar | the mixing coefficient |
# | $p_i$ | `mixed_priority(p_td, p_time, mix)` | (N,) | Eq. 10, a sum |
#
# (The theorem's rule is that of Eqs. 10–11 for ε = 0 and 0 < β < 1, claim T3-h.)

# %%
import numpy as np
from exercises import check, solution
from lesson import show, source
from loops import F, row
from pictures import theorem_3 as pictures

from gbdqn_ref.replay import mixed_priority, td_priority, time_priority

source(mixed_priority, td_priority, time_priority)


# %%
def normalise(p):
    """Priorities as probabilities."""
    return p / p.sum()


# %% [markdown]
# ## Theorem 3 · the smallest counterexample
#
# > **Predict.** The goal has moved, and the buffer holds two transitions. The newer one
# > has |δ| = 2 and recency 1. The older one has |δ| = 1 and recency ½. The ideal is
# > proportional to (2, ½), so P* = (4/5, 1/5). Which β gives it?

# %% tags=["predicted"]
p_td, p_time = td_priority(row(2, 1)[0], 0, 1), row(1, F(1, 2))[0]
ideal = normalise(p_td * p_time)
for mix in (F(0), F(1, 10), F(1, 2), F(9, 10), F(1)):
    P = normalise(mixed_priority(p_td, p_time, mix))
    naive = [mix * d + (1 - mix) * t for d, t in zip(p_td, p_time, strict=True)]
    assert P.tolist() == [p / sum(naive) for p in naive] == [F(2, 3), F(1, 3)]
    print(f"β = {float(mix):.1f}   P = {P[0]} {P[1]}")
print(f"ideal     P* = {ideal[0]} {ideal[1]}")
distance = abs(P - ideal).sum() / 2
assert ideal.tolist() == [F(4, 5), F(1, 5)] and distance == F(2, 15)

# %% [markdown]
# None (claim T3-a). |δ| alone prefers the newer one 2 : 1, and so does recency alone.
# Then every mixture does. The product prefers it 4 : 1.
#
# Half of the sum of all |P − P*| is the **total variation distance**. It is 0 if the two
# are equal, and 1 if no transition is drawn by both. Here it is 2/15, for every β.
#
# In general, a mixture's ratio lies *between* the ratios of its two parts, and if both
# parts prefer the same transition the product lies outside (claim T3-k).
#
# **Exercise 1.** Transitions are given by |δ| and recency. How far is the rule from the
# ideal?


# %%
def distance_to_ideal(p_td, p_time, mix):
    """The total variation distance of P from P*."""
    ...  # yours


distance_to_ideal = check("distance_to_ideal", distance_to_ideal)
solution("distance_to_ideal")

# %%
assert np.isclose(
    distance_to_ideal(np.array([2, 1.0]), np.array([1, 0.5]), 0.3), 2 / 15
)

# %% [markdown]
# Can the rule ever be right? It can, if the older transition has the larger error.

# %%
found = normalise(mixed_priority(row(1, 2)[0], row(1, F(1, 4))[0], F(1, 7)))
assert found.tolist() == normalise(row(1, 2)[0] * row(1, F(1, 4))[0]).tolist()

pairs = {"|δ| = (2, 1)": ((2, 1), (1, 1 / 2)), "|δ| = (3, 1)": ((3, 1), (1, 1 / 2))}
pairs["|δ| = (1, 2)"] = ((1, 2), (1, 1 / 4))
show(
    pictures.ratios(pairs),
    alt="The ratio P₁ : P₂ of three pairs of transitions as β goes from 0 to 1. Two "
    "lines stay below the diamonds of their products, 4 and 6. The third, whose older "
    "transition has the larger error, reaches its product 2 at β = 1/7.",
)

# %% [markdown]
# With more transitions this is a rare accident: |δ| must rise with age along one
# certain curve (claim T3-c). Just after a drift it is the other way round, since the
# newest transitions have the largest errors.
#
# ## Theorem 3 · a larger buffer
#
# > **Predict.** |δ| lies between 0.5 and 1.5 for all transitions, recency falls by 1 %
# > per step, and β = ½. The buffer grows from 100 to a million. Does P come nearer to
# > the ideal? To what does it come nearer?

# %% tags=["predicted"]
rng, sizes = np.random.default_rng(0), (10**2, 10**3, 10**4, 10**5, 10**6)
from_ideal, from_per = [], []
for n in sizes:
    p_td = td_priority(rng.uniform(0.5, 1.5, n), 0, 1)
    p_time = time_priority(np.arange(n), 0.01)
    P = normalise(mixed_priority(p_td, p_time, 0.5))
    from_ideal.append(abs(P - normalise(p_td * p_time)).sum() / 2)
    from_per.append(abs(P - normalise(p_td)).sum() / 2)
print("from the ideal:  ", *np.round(from_ideal, 3))
print("from |δ| alone:  ", *np.round(from_per, 3))
assert from_ideal == sorted(from_ideal) and from_ideal[-1] > 0.99
assert from_per[-1] < 0.001

# %%
show(
    pictures.growth(sizes, from_ideal, from_per),
    alt="Total variation distance against buffer size from a hundred to a million. The "
    "distance from the ideal rises to 1; the distance from priorities without recency "
    "falls to 0.",
)

# %% [markdown]
# The rule moves away from the ideal until the two have almost nothing in common (claim
# T3-b). It tends to priorities *without* recency, by |δ| alone.
#
# The reason is in the sums. Recency is a **geometric sequence**, and its sum is bounded,
# however many data there are. The sum of |δ| grows with N. So the share of recency in
# the rule shrinks like 1/N, while the ideal keeps to the newest few hundred.
#
# $$\sum_{i} e^{-\alpha(T-t_i)} \le \frac{1}{1-e^{-\alpha}}, \qquad
#   \sum_i |\delta_i| \ge m N \quad \text{if all } |\delta_i| \ge m$$
#
# This needs fixed α and β > 0, and $0 < m \le |\delta_i| \le M$; T3-b has the proof's
# bound. If |δ| fades with age as fast as recency does, the distance stays near ¼.

# %%
faded = np.exp(-0.001 * np.arange(20_000))
stays = distance_to_ideal(faded, faded, 0.5)
print(f"|δ| that fades like recency: {stays:.3f}")
assert np.isclose(stays, 0.25, atol=0.001)

# %% [markdown]
# **Exercise 2.** Which share of P does recency have, if |δ| = 1 for all N transitions?


# %%
def share_of_recency(n, rate, mix):
    """The sum of the recency terms of Eq. 10, as a part of the sum of all terms."""
    ...  # yours


share_of_recency = check("share_of_recency", share_of_recency)
solution("share_of_recency")

# %%
for n in (100, 10_000, 1_000_000):
    print(
        f"N = {n:9,}: {share_of_recency(n, 0.01, 0.5):.2%} of the draws go by recency"
    )
assert share_of_recency(10**6, 0.01, 0.5) < 1e-3

# %% [markdown]
# ## Theorem 3 · the variance
#
# The second half of the theorem says that P “minimizes the variance” among mixtures.
# Variance of what? One draw from P estimates the sum of some numbers f, by $f_i/P_i$.
# The variance is the mean squared distance of such estimates from the sum:
#
# $$V(P) = \sum_i \frac{f_i^2}{P_i} - \Big(\sum_i f_i\Big)^2$$
#
# The best P is proportional to |f| (claim T3-g). So which P is best depends on f.
#
# > **Predict.** Three transitions have |δ| = (1, 2, 4) and recencies (1, ½, ¼), so P*
# > draws all three alike. Which P is best for f = |δ| · recency? And for f = |δ|?

# %% tags=["predicted"]
p_td, p_time = row(1, 2, 4)[0], row(1, F(1, 2), F(1, 4))[0]
rules = {
    f"β = {b}": normalise(mixed_priority(p_td, p_time, b))
    for b in (F(1, 5), F(1, 2), F(1))
}
rules["P*"] = normalise(p_td * p_time)


def variance(f, P):
    return (f**2 / P).sum() - f.sum() ** 2


aged, plain = (
    {k: variance(f, P) for k, P in rules.items()} for f in (p_td * p_time, p_td)
)
print("f =      |δ|·rec.      |δ|")
for name in rules:
    print(f"{name:8} {float(aged[name]):8.3f} {float(plain[name]):8.3f}")
assert aged["P*"] == 0 and aged["β = 1/5"] == F(1, 10)
assert plain["β = 1"] == 0 and plain["P*"] == 14 == max(plain.values())

# %% [markdown]
# P* is best for the first f and the worst for the second (claim T3-f). With full
# importance weights, 1/(NP), GB-DQN estimates a sum without age: a transition's
# share of the gradient is $|\delta - h|\,\|\nabla h\|$ (claim T3-j).
#
# The sketch takes three more steps, and none holds as it stands. The mixture nearest to
# the product is not the product, not even if nearness is measured as in the sketch, by
# the Kullback–Leibler divergence, another measure of how far two distributions are
# apart (claim T3-d). $|\delta|^\gamma$ tends to |δ| if γ tends to 1, but not because
# the buffer grows (claim T3-e). And $P(i)$ does not tend to $P^*(i)$ for the newest
# transition (claim T3-i).
#
# ## What holds instead
#
# If you want the ideal, multiply: $p_i = |\delta_i|\, e^{-\alpha(T-t_i)}$. That is P*
# itself, at every size of the buffer. If you want a sum, let β shrink as the buffer
# grows, or measure age as a part of the buffer's size. Then the share of recency stays.

# %%
shares = [share_of_recency(n, 10 / n, 0.5) for n in (10**2, 10**4, 10**6)]
print("recency's share, if the rate is 10/N:", *np.round(shares, 3))
assert max(shares) - min(shares) < 0.01

# %% [markdown]
# ## Verdict
#
# | what is said | verdict | claims |
# |---|---|---|
# | the rule draws by the product | fails: a sum lies between its parts | T3-a, T3-k |
# | it tends to the product as the buffer grows | fails: it tends to \|δ\| alone | T3-b |
# | it has the smallest variance of all mixtures | depends on what is estimated | T3-f, T3-g |

# %% [markdown]
# ## Summary
#
# A sum of TD error and recency lies between the two; their product does not, if both
# prefer the same transition. As the buffer grows, the share of recency falls like 1/N,
# and the rule draws by the TD error alone. Which distribution has the smallest variance
# depends on what is estimated. To draw by the product, multiply.
#
# [← 9](09_theorem_2.ipynb) · [contents](README.md) · [11 →](11_theorem_4.ipynb)
