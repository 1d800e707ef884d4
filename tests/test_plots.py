"""What each figure shows, read from its artists and checked by hand on a few rows."""

import subprocess
import sys
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from helpers import contents, environ
from matplotlib.colors import to_hex, to_rgba
from matplotlib.text import Text

from gbdqn_ref import UsageError, plots, stats
from gbdqn_ref.agents import AGENTS, BLUE, ORANGE
from gbdqn_ref.config import Config

SCHEDULE = [
    {"episode": 8, "gravity": 3, "length": 2},
    {"episode": 14, "reset": True},
    {"episode": 90, "force": 2},
]
CONFIG = Config(env="cartpole", seed=7, episodes=20, schedule=SCHEDULE)
STARTS, SHADED = [8, 14], [(8, 14)]


def records(returns, first=0):
    """The fields of a run's records that the figures read."""
    return [{"episode": k, "return": float(r)} for k, r in enumerate(returns, first)]


def summary(seed=0, final=0.0, regimes=()):
    """The summary of a run, given (drop, recovery, area) of each regime after the first."""
    rows = [dict(zip(("drop", "recovery", "area"), row, strict=True)) for row in regimes]
    return {"seed": seed, "final_return": final, "regimes": [{}, *rows]}


def finals(*values):
    return [summary(seed, final) for seed, final in enumerate(values)]


def points(line):
    """(x, y) of every point of a line."""
    return list(zip(*(np.asarray(line.get_data()).tolist()), strict=True))


def look(line):
    """(colour, mark, line style) of a line."""
    return to_hex(line.get_color()).upper(), line.get_marker(), line.get_linestyle()


def looks_like(agent, mark=True, line=False):
    """(colour, mark, line style) of an agent's mark, or of its line."""
    agent = AGENTS[agent]
    mark, line = agent.mark if mark else "None", agent.line if line else "None"
    return agent.colour.upper(), mark, line


def upright(axes):
    """The x of each vertical line."""
    lines = [line.get_xdata() for line in axes.lines if list(line.get_ydata()) == [0, 1]]
    return [x for x, _ in lines]


def level(axes):
    """The y of each horizontal line."""
    lines = [line.get_ydata() for line in axes.lines if list(line.get_xdata()) == [0, 1]]
    return [y for y, _ in lines]


def shaded(axes):
    """The x-range of each shaded span."""
    boxes = [patch.get_bbox() for patch in axes.patches]
    assert all((box.y0, box.y1) == (0, 1) for box in boxes)
    return [(box.x0, box.x1) for box in boxes]


def texts(axes):
    return {text.get_text(): text for text in axes.texts}


# --- the learning curve ---------------------------------------------------------------------------


def test_a_learning_curve_shows_the_returns_and_their_trailing_means():
    """The mean of 0, …, 14 is 7, at episode 14."""
    runs = {"dqn": records(range(20)), "gbdqn-per": records([50] * 20)}
    axes = plots.learning_curves(runs, CONFIG, -3.0).axes[0]
    first, smooth, others, smooth_too, random, *_ = axes.lines
    assert points(first) == [(k, k) for k in range(20)]
    assert points(smooth) == [(14, 7), (15, 8), (16, 9), (17, 10), (18, 11), (19, 12)]
    assert points(others) == [(k, 50) for k in range(20)]
    assert points(smooth_too) == [(k, 50) for k in range(14, 20)]
    assert (look(first), look(others)) == (looks_like("dqn"), looks_like("gbdqn-per"))
    assert look(smooth) == looks_like("dqn", mark=False, line=True)
    assert look(smooth_too) == looks_like("gbdqn-per", mark=False, line=True)
    assert look(smooth_too)[2] == "--", "a dashed agent"
    assert list(random.get_ydata()) == [-3, -3]


def test_a_learning_curve_is_drawn_at_its_episodes():
    axes = plots.learning_curves({"dqn": records(range(15), first=4)}, CONFIG, 0.0).axes[0]
    assert points(axes.lines[0]) == [(4 + k, k) for k in range(15)]
    assert points(axes.lines[1]) == [(18, 7)]


def test_a_learning_curve_says_what_it_shows():
    figure = plots.learning_curves({"dqn": records(range(20))}, CONFIG, -3.0)
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("episode", "return")
    assert figure.get_suptitle() == (
        "CartPole, seed 7: episodes, and means of the last 15; grey: drifted physics"
    )


def test_regimes_within_the_run_are_marked_shaded_and_named():
    """The run ends before the drift at episode 90, and so does the axis."""
    axes = plots.learning_curves({"dqn": records(range(20))}, CONFIG, -3.0).axes[0]
    assert axes.get_xlim() == (0, 20)
    assert (upright(axes), shaded(axes)) == (STARTS, SHADED)
    names = [(text.get_position(), text.get_text(), text.get_rotation()) for text in axes.texts[2:]]
    assert names == [
        ((4, plots.ABOVE), "stock physics", 0),
        ((11, plots.ABOVE), "gravity × 3\nlength × 2", 0),
        ((17, plots.ABOVE), "reset:\nstock physics", 0),
    ]
    assert all(text.get_transform() == axes.get_xaxis_transform() for text in axes.texts[2:])
    assert {(text.get_ha(), text.get_va()) for text in axes.texts[2:]} == {("center", "bottom")}


def test_names_of_narrow_regimes_are_rotated():
    """A regime of 110 episodes is as wide as its name; one of 109 is not."""
    for start, turned in ((890, 0), (891, 90)):
        config = Config(episodes=1000, schedule=[{"episode": start, "gravity": 2}])
        axes = plots.learning_curves({"dqn": records([0, 1])}, config, 0.0).axes[0]
        assert [text.get_rotation() for text in axes.texts[2:]] == [turned, turned]


def test_a_curve_is_labelled_at_its_right_end():
    """The label stands beside the axes where the trailing mean ends, in the curve's colour."""
    runs = {"dqn": records(range(20)), "reset": records([40] * 19 + [100])}
    axes = plots.learning_curves(runs, CONFIG, 80.0).axes[0]
    low, high = axes.get_ylim()
    for name, height, colour in (
        ("DQN", 12, AGENTS["dqn"].colour),
        ("Reset-DQN", 44, AGENTS["reset"].colour),
        ("random policy", 80, plots.GREY),
    ):
        text = texts(axes)[name]
        assert text.get_position() == (plots.BESIDE, pytest.approx((height - low) / (high - low)))
        assert text.get_color() == colour and text.get_transform() == axes.transAxes


def test_a_run_too_short_for_a_trailing_mean_is_labelled_at_its_last_return():
    axes = plots.learning_curves({"dqn": records([0, 10, 4])}, CONFIG, 10.0).axes[0]
    low, high = axes.get_ylim()
    assert texts(axes)["DQN"].get_position()[1] == pytest.approx((4 - low) / (high - low))
    assert points(axes.lines[1]) == []


def test_overlapping_labels_move_apart_equally():
    gap = plots.LINE_HEIGHT
    apart = plots.apart(np.array([0.5, 0.1, 0.5 + gap / 2]))
    np.testing.assert_allclose(apart, [0.5 - gap / 4, 0.1, 0.5 + gap * 3 / 4])
    same = plots.apart(np.full(5, 0.3))
    np.testing.assert_allclose(np.diff(same), gap, rtol=0.01)
    assert same.mean() == pytest.approx(0.3)


# --- a study --------------------------------------------------------------------------------------


def study(**runs):
    """The panels of study_curves, and the figure."""
    rows = {
        agent.replace("_", "-"): [records(each) for each in seeds] for agent, seeds in runs.items()
    }
    figure = plots.study_curves(rows, CONFIG, -3.0)
    return figure.axes, figure


def test_a_panel_shows_every_seed_their_mean_and_dqns_mean():
    """At episode 14 the trailing mean of 0, 3, 6, … is 21; the mean of 21, 5 and 1 is 9."""
    seeds = [range(0, 60, 3), [5] * 20, [1] * 20]
    axes, _ = study(gbdqn=seeds, dqn=[[1] * 20, [2] * 20, [6] * 20])
    *thin, mean, rival, random = axes[0].lines[:6]
    assert [points(line) for line in thin] == [
        [(14 + k, 21 + 3 * k) for k in range(6)],
        [(14 + k, 5) for k in range(6)],
        [(14 + k, 1) for k in range(6)],
    ]
    assert points(mean) == [(14 + k, 9 + k) for k in range(6)]
    assert {look(line) for line in (*thin, mean)} == {(AGENTS["gbdqn"].colour, "None", "-")}
    assert points(rival) == [(14 + k, 3) for k in range(6)] and look(rival)[2] == "--"
    assert list(random.get_ydata()) == [-3, -3]
    assert [points(line)[0][1] for line in axes[1].lines[:5]] == [1, 2, 6, 3, -3]


def test_the_band_is_the_95_percent_bootstrap_interval_of_the_mean():
    """With one 10 and four 0, a resample has n tens with probability C(5, n) 0.2ⁿ 0.8⁵⁻ⁿ.

    Its mean is 2n. At most three tens have 99.3 %, at most two 94.2 %: the interval is 0 to 6.
    """
    axes, _ = study(dqn=[[0] * 20] * 4 + [[10] * 20])
    (band,) = axes[0].collections
    corners = band.get_paths()[0].vertices
    assert set(corners[:, 0]) == set(range(14, 20)) and set(corners[:, 1]) == {0, 6}
    assert to_hex(band.get_facecolor()[0]).upper() == AGENTS["dqn"].colour


def test_a_single_seed_has_no_band():
    axes, _ = study(dqn=[range(20)])
    assert not axes[0].collections


def test_panels_follow_the_order_of_the_agents_and_spare_ones_are_hidden():
    axes, figure = study(dqn=[[1] * 20], reset=[[2] * 20], gbdqn=[[3] * 20], dqn_recency=[[4] * 20])
    names = [panel.get_title(loc="left") for panel in axes]
    assert names == ["DQN", "Reset-DQN", "GB-DQN", "DQN-recency", "", ""]
    assert [points(panel.lines[0])[0][1] for panel in axes[:4]] == [1, 2, 3, 4]
    assert [panel.get_visible() for panel in axes] == [True] * 4 + [False] * 2
    assert [panel.title.get_text() for panel in axes] == [""] * 6
    figure.draw_without_rendering()
    labelled = [panel.xaxis.get_tick_params()["labelbottom"] for panel in axes[:4]]
    assert labelled == [False, True, True, True], "the lowest of each column"
    assert axes[0].get_subplotspec().get_gridspec().get_geometry() == (2, 3)
    assert len({panel.get_ylim() for panel in axes}) == 1


def test_a_study_says_what_it_shows():
    _, figure = study(dqn=[[1] * 20])
    assert figure.get_supxlabel() == "episode (grey: drifted physics)"
    assert figure.get_supylabel() == "return, mean of the last 15"
    assert figure.get_suptitle() == (
        "CartPole: seeds (thin), their mean (thick), its 95 % bootstrap interval (band);\n"
        "DQN's mean (dashed), the random policy (dotted)"
    )


def test_every_panel_marks_the_regimes_within_the_run():
    axes, _ = study(gbdqn=[[1] * 20], dqn=[[1] * 20])
    for panel in axes:
        assert (upright(panel), shaded(panel), panel.get_xlim()) == (STARTS, SHADED, (0, 20))


def test_dqns_mean_is_drawn_only_in_other_agents_panels():
    for runs, lines in ((dict(gbdqn=[[1] * 20]), 3), (dict(dqn=[[1] * 20]), 3)):
        axes, _ = study(**runs)
        assert len(axes[0].lines) == lines + len(STARTS)


# --- after each drift -----------------------------------------------------------------------------


UNDEFINED = (None, None, None)
AFTER = {  # of five seeds, after both drifts: (drop, recovery, area)
    "dqn": [
        summary(regimes=[first, (0.5, 2, 0.75)])
        for first in [(0.5, 3, 0.9), (0.5, 6, 0.4), (0.9, None, 0.1), UNDEFINED, UNDEFINED]
    ],
    "random": [summary(regimes=[(0.5, 5, 0.5)] * 2)] * 5,
    "gbdqn": [
        summary(regimes=[first, UNDEFINED])
        for first in [(0.1, 4, 1.5), *[(0.9, None, 0.2)] * 2, (0.9, None, -0.3), (0.2, 2, 0.3)]
    ],
}
NEVER = 6 * (1 + plots.LANE)  # the longest regime after a drift has 6 episodes


@pytest.fixture
def adaptation():
    return plots.adaptation(AFTER, CONFIG)


def placed(axes):
    """{x: [(y, look), …]} of all marks, without the lines from side to side."""
    lines = [line for line in axes.lines if list(line.get_xdata()) != [0, 1]]
    found = {}
    for line in lines:
        for x, y in points(line):
            found.setdefault(round(x, 6), []).append((y, look(line)))
    return found


def test_recoveries_and_their_medians_stand_side_by_side(adaptation):
    """DQN's 3, 6 and never have the median 6; GB-DQN's 2, 4 and three nevers have never."""
    above, _ = adaptation.axes
    dqn, gbdqn = looks_like("dqn"), looks_like("gbdqn")
    dot, other = (dqn[0], "o", "None"), (gbdqn[0], "o", "None")
    assert placed(above) == {
        0.8: [(3, dot), (6, dot), (NEVER, dot), (6, dqn)],
        1.2: [(4, other), *[(NEVER, other)] * 3, (2, other), (NEVER, gbdqn)],
        1.8: [*[(2, dot)] * 5, (2, dqn)],
    }


def test_areas_and_their_medians_stand_below_them(adaptation):
    """Undefined areas are left out: 0.9, 0.4 and 0.1 remain."""
    _, below = adaptation.axes
    areas = {x: [y for y, _ in marks] for x, marks in placed(below).items()}
    assert areas == {
        0.8: [0.9, 0.4, 0.1, 0.4],
        1.2: [1.5, 0.2, 0.2, -0.3, 0.3, 0.2],
        1.8: [*[0.75] * 5, 0.75],
    }
    assert placed(below)[1.2][-1][1] == looks_like("gbdqn")


def test_undefined_recoveries_are_counted_apart_from_missing_ones(adaptation):
    above, below = adaptation.axes
    counts = [(round(text.get_position()[0], 6), text.get_text()) for text in above.texts]
    assert counts == [(0.8, "2"), (2.2, "5")]
    assert [text.get_color() for text in above.texts] == [
        AGENTS[agent].colour for agent in ("dqn", "gbdqn")
    ]
    for text in above.texts:
        assert text.get_position()[1] == 1
        assert text.get_transform() == above.get_xaxis_transform()
    assert not below.texts


def test_the_axes_after_a_drift(adaptation):
    above, below = adaptation.axes
    assert level(above) == [NEVER] and level(below) == [1, 0]
    assert above.get_ylim() == (0, pytest.approx(6 * (1 + 2 * plots.LANE)))
    assert above.get_yticks()[-1] == NEVER
    labels = [label.get_text() for label in above.get_yticklabels()]
    assert labels == [*(f"{tick:g}" for tick in above.get_yticks()[:-1]), "never"]
    assert labels[:2] == ["0", "1"] and labels[-2] == "6"
    assert below.get_xlim() == (0.5, 2.5) and list(below.get_xticks()) == [1, 2]
    assert [label.get_text() for label in below.get_xticklabels()] == [
        "gravity × 3\nlength × 2",
        "reset:\nstock physics",
    ]
    assert above.get_ylabel() == "recovery (episodes)"
    assert below.get_ylabel() == "area (0: random, 1: as before)"
    assert above.get_shared_x_axes().joined(above, below)


def test_the_legend_after_a_drift_lists_the_agents_that_learn(adaptation):
    (legend,) = adaptation.legends
    assert [text.get_text() for text in legend.get_texts()] == ["DQN", "GB-DQN"]
    assert [look(line) for line in legend.get_lines()] == [looks_like("dqn"), looks_like("gbdqn")]
    assert adaptation.get_suptitle() == (
        "CartPole, after each drift: seeds (dots) and their medians (marks);\n"
        "numbers at the top: seeds with nothing to lose, whose recovery is undefined"
    )


# --- differences to DQN ---------------------------------------------------------------------------


def test_the_forest_shows_each_agents_difference_to_dqn():
    """The differences 1, 2, 3, 4, 100 have the interquartile mean 3 and the mean 22."""
    dqn, ours = [10, 20, 30, 40, 50], [11, 22, 33, 44, 150]
    summaries = {"gbdqn": finals(*ours), "dqn": finals(*dqn), "reset": finals(0, 10, 20, 30, 40)}
    figure = plots.forest(summaries, CONFIG)
    (axes,) = figure.axes
    zero, *lower, dots, bar, mark = axes.lines
    assert list(zero.get_xdata()) == [0, 0]
    assert points(dots) == [(1, 1), (2, 1), (3, 1), (4, 1), (100, 1)]
    assert points(mark) == [(3, 1)] and look(mark) == looks_like("gbdqn")
    low, high = stats.bootstrap_interval([1, 2, 3, 4, 100], np.random.default_rng(0))
    assert points(bar) == [(low, 1), (high, 1)] and low < 3 < high
    assert look(bar) == looks_like("gbdqn", mark=False, line=True)
    assert look(dots) == (AGENTS["gbdqn"].colour, "o", "None")
    assert [points(line) for line in lower] == [[(-10, 0)] * n for n in (5, 2, 1)]
    assert list(axes.get_yticks()) == [0, 1] and axes.get_ylim() == (-0.6, 1.6)
    assert [label.get_text() for label in axes.get_yticklabels()] == ["Reset-DQN", "GB-DQN"]
    assert axes.get_xlabel() == "final return minus DQN's"
    assert figure.get_suptitle() == (
        "CartPole: seeds (dots), their IQM (mark), its 95 % bootstrap interval (bar)"
    )


def test_the_forest_pairs_runs_by_seed():
    ours = [summary(5, 3), summary(2, 13)]
    dqn = [summary(2, 10), summary(9, 99), summary(5, 0)]
    axes = plots.forest({"gbdqn": ours, "dqn": dqn}, CONFIG).axes[0]
    assert points(axes.lines[1]) == [(3, 0), (3, 0)]


def test_a_single_pair_has_no_interval():
    axes = plots.forest({"gbdqn": finals(5), "dqn": finals(8)}, CONFIG).axes[0]
    assert [points(line) for line in axes.lines[1:]] == [[(-3, 0)], [(-3, 0)]]


# --- maps of values -------------------------------------------------------------------------------


@pytest.fixture
def maps():
    """The greedy action changes in one corner."""
    before = np.zeros((5, 5, 3))
    before[..., 0] = 1.0
    after = before.copy()
    after[4, 4] = [0.0, 0.0, 3.0]
    return plots.value_maps(before, after, 12)


def pictures(figure):
    return [axes.images[0] for axes in figure.axes[:6]]


def test_the_maps_show_what_the_booster_added(maps):
    """That corner is coloured above and black below."""
    shown = [np.asarray(image.get_array(), float) for image in pictures(maps)]
    corner = np.zeros((5, 5))
    corner[4, 4] = 1
    above = [0 * corner + 1, 3 * corner, 1 + 2 * corner]
    np.testing.assert_array_equal(shown, [*above, 0 * corner, corner, 2 * corner])


def test_the_added_value_is_of_the_action_preferred_afterwards():
    """The booster adds 5 to the second action, which stays worse than the first."""
    before = np.full((2, 2, 3), [9.0, 0.0, 0.0])
    figure = plots.value_maps(before, before + [-1.0, 5.0, 0.0], 2)
    assert (pictures(figure)[1].get_array() == -1).all()


def test_the_maps_share_colour_scales_and_labels(maps):
    above, below = [(1, 3), (-3, 3), (1, 3)], [(0, 2), (0, 1), (0, 2)]
    assert [image.get_clim() for image in pictures(maps)] == above + below
    assert [image.get_cmap().name for image in pictures(maps)[:3]] == ["viridis", "PuOr", "viridis"]
    assert pictures(maps)[4].get_cmap().name == "Greys"
    colours = [tuple(to_rgba(colour)) for colour in (BLUE, "0.9", ORANGE)]
    for image in pictures(maps)[3::2]:
        assert [tuple(image.get_cmap()(k)) for k in range(3)] == colours
    (legend,) = maps.legends
    assert [text.get_text() for text in legend.get_texts()] == ["left", "coast", "right"]
    assert [patch.get_facecolor() for patch in legend.get_patches()] == colours
    assert [axes.get_title(loc="left") for axes in maps.axes[:6]] == [
        "$\\mathrm{max}_a\\, Q_{11}$",
        "$\\alpha\\, h_{12}$, at $Q_{12}$'s greedy action",
        "$\\mathrm{max}_a\\, Q_{12}$",
        "greedy action of $Q_{11}$",
        "changed (black)",
        "greedy action of $Q_{12}$",
    ]
    assert [axes.get_xlabel() for axes in maps.axes[:6]] == [""] * 3 + ["position"] * 3
    assert [axes.get_ylabel() for axes in maps.axes[:6]] == ["velocity per step", "", ""] * 2


def test_each_value_map_has_a_colour_bar(maps):
    scales = maps.axes[6:]
    assert len(scales) == 3
    assert [axes._colorbar.mappable for axes in scales] == pictures(maps)[:3]


def test_the_colour_scale_starts_at_the_lowest_greedy_value_of_both():
    before = np.full((2, 2, 3), -5.0)
    before[0, 0, 1] = -2
    figure = plots.value_maps(before, before + 1, 2)
    assert pictures(figure)[0].get_clim() == (-5, -1)
    assert pictures(plots.value_maps(before, before - 1, 2))[0].get_clim() == (-6, -2)


def test_the_maps_cover_the_plane_with_the_lowest_velocity_at_the_bottom(maps):
    for image in pictures(maps):
        assert tuple(image.get_extent()) == (-1.2, 0.6, -0.07, 0.07)
        assert image.origin == "lower"


# --- all of them ----------------------------------------------------------------------------------


def synthetic(config, agent, seed):
    """Records and summary of a run that learns, and loses half of its return at each drift."""
    rng = np.random.default_rng([list(AGENTS).index(agent), seed])
    rows = []
    for k, regime in enumerate(config.regimes):
        n = regime.end - regime.start
        returns = 200 * (1 - 0.5 * np.exp(-np.arange(n) / 20)) + rng.normal(0, 30, n)
        event = regime.event or ""
        rows += [{"regime": k, "event": event, "return": float(r)} for r in returns]
    rows = [row | {"episode": episode} for episode, row in enumerate(rows)]
    returns = [row["return"] for row in rows]
    regimes = stats.regime_table(rows, 0.0)
    return rows, {"seed": seed, "final_return": np.mean(returns[-50:]), "regimes": regimes}


def drawn(kind, config, agents):
    made = {agent: [synthetic(config, agent, seed) for seed in range(3)] for agent in agents}
    rows = {agent: [rows for rows, _ in runs] for agent, runs in made.items()}
    summaries = {agent: [summary for _, summary in runs] for agent, runs in made.items()}
    return {
        "learning_curves": lambda: plots.learning_curves(
            {agent: runs[0] for agent, runs in rows.items()}, config, 0.0
        ),
        "study_curves": lambda: plots.study_curves(rows, config, 0.0),
        "adaptation": lambda: plots.adaptation(summaries, config),
        "forest": lambda: plots.forest(summaries, config),
        "value_maps": lambda: plots.value_maps(np.zeros((3, 3, 3)), np.ones((3, 3, 3)), 2),
    }[kind]()


KINDS = ["learning_curves", "study_curves", "adaptation", "forest", "value_maps"]


def unseen(figure):
    """The texts that are not drawn: ticks beyond the ends of an axis, and hidden axes."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = axis.get_major_ticks()
            yield from (tick.label1 for tick in ticks if not low <= tick.get_loc() <= high)
        if not axes.get_visible():
            yield from axes.findobj(Text)


@pytest.mark.parametrize("kind", KINDS)
def test_no_two_texts_overlap(kind):
    """With all agents and the preset with the longest regime names."""
    figure = drawn(kind, Config.preset("hopper"), AGENTS)
    figure.draw_without_rendering()
    hidden = set(unseen(figure))
    texts = [text for text in figure.findobj(Text) if text not in hidden and text.get_text()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts if text.get_visible()]
    assert len(boxes) > 10
    for (one, box), (other, its) in combinations(boxes, 2):
        assert not box.padded(-1).overlaps(its), (one, other)


@pytest.mark.parametrize("kind", KINDS)
def test_a_figure_does_not_depend_on_the_users_matplotlibrc(tmp_path, kind):
    theirs = {"text.usetex": True, "font.size": 30, "font.family": "monospace"}
    theirs |= {"lines.linewidth": 9, "axes.grid": True, "image.cmap": "jet", "legend.fontsize": 3}
    theirs |= {"savefig.bbox": "tight", "savefig.transparent": True, "figure.facecolor": "red"}
    agents = ["gbdqn", "dqn"]
    plots.save(drawn(kind, CONFIG, agents), tmp_path / "ours.png")
    with matplotlib.rc_context(theirs):
        plots.save(drawn(kind, CONFIG, agents), tmp_path / "theirs.png")
        assert matplotlib.rcParams["font.size"] == 30, "the user's figures keep it"
    assert (tmp_path / "ours.png").read_bytes() == (tmp_path / "theirs.png").read_bytes()


def test_a_figure_is_saved_as_png_in_a_new_folder(tmp_path):
    path = tmp_path / "a" / "new" / "forest.png"
    plots.save(drawn("forest", CONFIG, ["gbdqn", "dqn"]), path)
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    width = int.from_bytes(path.read_bytes()[16:20])
    assert width == plots.FOREST[0] * plots.DPI
    assert set(contents(tmp_path)) == {"a", "a/new", "a/new/forest.png"}


@pytest.mark.parametrize(
    ("name", "words"),
    [("x.pdf", r"is a \.png file"), ("x", r"is a \.png file"), (".", "is a folder")],
)
def test_another_file_type_is_refused(tmp_path, name, words):
    with pytest.raises(UsageError, match=words):
        plots.save(drawn("forest", CONFIG, ["gbdqn", "dqn"]), tmp_path / name)
    assert not contents(tmp_path)


@pytest.mark.parametrize(
    ("backend", "before", "then"),
    [
        ("nonsense", "", ""),  # unknown, but nothing is drawn on a screen
        ("svg", "", "svg"),  # still set for the user's figures
        ("svg", "import matplotlib; matplotlib.use('pdf')", "pdf"),  # an earlier choice wins
    ],
)
def test_any_mplbackend_works(backend, before, then):
    code = f"""{before}
import gbdqn_ref.watch, os, sys, matplotlib
assert "matplotlib.pyplot" not in sys.modules or {bool(before)}
assert os.environ["MPLBACKEND"] == {backend!r}
print(dict.__getitem__(matplotlib.rcParams, "backend"))
"""
    result = subprocess.run(
        [sys.executable, "-c", code], env=environ(MPLBACKEND=backend), capture_output=True
    )
    assert (result.returncode, result.stderr) == (0, b"")
    assert then.encode() in result.stdout.lower()
