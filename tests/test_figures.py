"""The live figures: their scripts compute what the package computes, and they obey in a browser."""

import itertools
import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from helpers import CHROMIUM

from gbdqn_ref import stats

FOLDER = Path(__file__).parent.parent / "site" / "figures"
sys.path.insert(0, str(FOLDER))
with plt.rc_context():  # the look of the lesson's pictures stays there
    import frames
    import learning_curves as curves
    from pictures import instrument

KILOBYTE = 1_000
CLOSE = dict(rtol=0, atol=1e-12)
ALPHAS = [k / 10 for k in range(1, 11)]
READINGS = list(itertools.product(("frozen", "live"), ("h", "alpha_h")))
WIDTHS = {"phone": 390, "wide": 760}
PAGES = *frames.FIGURES, "curves-three"
every_figure = pytest.mark.parametrize("name", frames.FIGURES)
every_width = pytest.mark.parametrize("width", WIDTHS.values(), ids=WIDTHS)


def script(name):
    return (FOLDER / f"{name}.js").read_text(encoding="utf-8")


# Without a browser


def test_the_scripts_are_small():
    assert sum(len(script(name).encode()) for name in ("live", *frames.FIGURES)) < 50 * KILOBYTE


@every_figure
def test_a_model_has_at_most_sixty_lines(name):
    """What computes values; the rest of the script draws them."""
    model = re.search(rf"^live\.{name} = \{{\n.*?^\}};$", script(name), re.MULTILINE | re.DOTALL)
    assert model[0].count("\n") < 60


@every_figure
def test_nothing_is_fetched(name):
    text = script("live") + script(name) + (FOLDER / "figures.css").read_text(encoding="utf-8")
    text = text.replace("http://www.w3.org/", "")  # names of namespaces
    assert not re.search(r"https?:|fetch\(|import\b|XMLHttp|@import|url\(", text)


@every_figure
def test_the_html_is_filled_in_and_the_same_each_time(name):
    html = frames.html(name)
    frames.parts.cache_clear()
    assert frames.html(name) == html
    without = re.sub(r"<script.*?</script>|<noscript>.*?</noscript>", "", html, flags=re.DOTALL)
    assert not re.search(r"[{}]", without)
    assert re.search(r"<noscript>\s*<svg.*?<title>", html, re.DOTALL)
    assert 'aria-live="polite"' in html


@every_figure
def test_claims_become_links(name):
    linked = frames.html(name, link=lambda claim: f"ledger.html#{claim.lower()}")
    assert len(re.findall(r'<a href="ledger\.html#[a-z]\d+(-[a-z])?">', linked)) > 0


def test_the_instruments_readings():
    """Frozen, one boost is a damped backup; live, it is Q* or an implicit step (B1–B3)."""
    mdp, Q = instrument.moved()
    assert (instrument.boost(mdp, Q) == mdp.bellman(Q)).all()
    np.testing.assert_allclose(instrument.boost(mdp, Q, "frozen", "alpha_h", 0.3), mdp.bellman(Q))
    np.testing.assert_array_equal(instrument.boost(mdp, Q, "live", "alpha_h", 0.3), mdp.q_star())
    after = instrument.boost(mdp, Q, "live", "h", 0.3)
    np.testing.assert_allclose(after, 0.7 * Q + 0.3 * mdp.bellman(after), atol=1e-9)


def test_what_the_instruments_picture_shows():
    """Each boost turns one room at most; ten are needed, or one whose target is live."""
    counts = [
        instrument.right_rooms(mdp, Q) for mdp, path in [instrument.boosted(10)] for Q in path
    ]
    assert counts[0] == 0 and counts[9] < counts[10] == 9
    assert max(np.diff(counts)) == 1
    assert instrument.right_rooms(*instrument.moved()) == 0
    figure = instrument.instrument(5)
    assert "4 of 9 rooms are right" in figure.axes[0].get_title()
    plt.close(figure)


def test_the_slider_is_made(capsys):
    pytest.importorskip("ipywidgets")
    instrument.slider()
    assert "interactive" in capsys.readouterr().out


def answers(name):
    """The numbered answers at the end of a figure's page."""
    text = (
        (FOLDER / f"{name}.md").read_text(encoding="utf-8").split("<summary>Answers</summary>")[1]
    )
    return re.findall(r"^\d\. (.*(?:\n   .*)*)", text, re.MULTILINE)


def test_the_answers_about_the_rooms():
    count, cancels, damped = answers("rooms")
    mdp, path = instrument.boosted(200, alpha=0.1)
    counts = [instrument.right_rooms(mdp, Q) for Q in path]
    assert count.startswith(f"{counts.index(9)}. ") and min(counts[counts.index(9) :]) == 9
    needed = {frames.boosts_needed(loss_on="alpha_h", alpha=alpha) for alpha in ALPHAS}
    assert needed == {frames.boosts_needed()} and f"{needed.pop()} boosts" in cancels
    assert damped.endswith(f"at boost {frames.boosts_needed(target='live', alpha=0.5)}.")


def test_the_answers_about_the_parabola():
    along, shrunk, length = answers("parabola")
    r = np.array([1.0, 0.0])
    for angle in (0, 180):
        h = frames.booster(angle, 1.3)
        assert frames.squared(frames.closed_form_alpha(r, h), h) == pytest.approx(0)
    for angle in (20, 60, 135):
        h = frames.booster(angle, 0.75)
        best = frames.closed_form_alpha(r, h)
        lowest = frames.squared(best, h)
        share = (1 - frames.squared(0.1 * best, h)) / (1 - lowest)
        assert shrunk.startswith(f"{100 * share:.0f} %")
        assert frames.closed_form_alpha(r, 2 * h) == pytest.approx(best / 2)
        assert frames.squared(best / 2, 2 * h) == pytest.approx(lowest)
    assert along.startswith("Angle 0° or 180°") and length.startswith("A/B halves")


def test_the_answers_about_the_replay():
    large, knobs, nothing = answers("replay")
    assert large.startswith("The new data")
    mix, rate, share = re.search(r"β = ([\d.]+) .* rate of ([\d.]+) leave (\d+) %", knobs).groups()
    settings = dict(mix=float(mix), rate=float(rate))
    assert settings["mix"] in frames.SLIDERS["mix"] and settings["rate"] in frames.SLIDERS["rate"]
    left = frames.stale(1_000, q=10, exponent=0.6, **settings)
    assert f"{100 * left:.0f}" == share and left < 0.5
    assert nothing.startswith("Nothing")
    stays = [frames.stale(1_000, q=q, exponent=0, **settings) for q in frames.SLIDERS["q"]]
    assert len(set(stays)) == 1


def test_the_answers_about_the_theorem():
    rises, below, never = answers("theorem")
    assert frames.theorem_1.boosted(0.9, 1.0, 1)[0].tolist() == [[0, 1], [0, 1]]
    own = {gamma: frames.squares(gamma, 1, 1)[1] for gamma in frames.GAMMAS}
    np.testing.assert_allclose(list(own.values()), [2 * gamma**2 for gamma in own])
    assert rises.startswith(f"From γ = {min(gamma for gamma in own if own[gamma] > 1)} on.")
    sums = [frames.squares(0.9, 1, m)[1] for m in range(10)]
    assert below == f"It takes {next(m for m in range(1, 10) if sums[m] < 1)} boosters."
    assert never.startswith("No.")
    for gamma, alpha in itertools.product(frames.GAMMAS, ALPHAS):
        largest = np.abs(frames.theorem_1.boosted(gamma, alpha, frames.BOOSTS)[:, 1]).max(1)
        bound = (1 - alpha + alpha * gamma) ** np.arange(frames.BOOSTS + 1)
        np.testing.assert_allclose(largest, bound, **CLOSE)
    figure = frames.theorem_1.boosts(0.9, 1.0, 3)
    axis = figure.axes[0]
    assert "γ = 0.9, α = 1" in (axis.get_title(), axis.get_title("left"))
    plt.close(figure)


# The learning curves, whatever is stored


@pytest.fixture(scope="module")
def three_tasks():
    """MountainCar's stored runs on all three tasks. On Acrobot DQN is missing, and reuse earns
    most; on CartPole a twin is missing, and reuse earns least.
    """
    study, rows, returns = curves.stored(), {}, {}
    tuned = dict.fromkeys(curves.LABELS, study.protocol.tuned["mountaincar"])
    for task, missing in ("mountaincar", ""), ("acrobot", "dqn"), ("cartpole", "twin"):
        returns[task] = {}
        for arm in set(curves.ARMS) - {missing}:
            for seed, row in study.rows["mountaincar", arm].items():
                rows[task, arm, seed] = row
                found = study.returns["mountaincar"][f"{arm}-{seed}"]
                returns[task][f"{arm}-{seed}"] = found[: 600 if task == "cartpole" else None]
    for task, arm, seed in rows:
        if arm == "reuse" and task != "mountaincar":
            value = dict(acrobot=-100.0, cartpole=-200.0)[task] + seed / 10_000
            rows[task, arm, seed] = rows[task, arm, seed] | dict(value=value)
    protocol = curves.evidence.Protocol(tuned=tuned)
    return curves.evidence.Study(SimpleNamespace(protocol=protocol, rows=rows, returns=returns))


def shown(study):
    """What the text and the script of the learning curves need."""
    text, frame, [(figure, alt)] = curves.figure(study)
    plt.close(figure)
    assert text["leads"] in alt and text["levels"] in alt
    return text, frame


def test_the_curves_are_the_means_of_the_stored_runs():
    study = curves.stored()
    for task, there in curves.arms(study).items():
        for arm in there:
            runs = list(study.curves(task, arm).values())
            points = range(0, len(runs[0]) - curves.WINDOW + 1, curves.EVERY)
            means = [[x[k : k + curves.WINDOW].mean() for x in runs] for k in points]
            want = [(stats.iqm(x), *np.quantile(x, [0.25, 0.75])) for x in means]
            got = np.cumsum(curves.steps(curves.curve(study, task, arm)), axis=1)
            assert np.abs(got.T - want).max() <= 0.5 + 1e-9


def test_the_data_of_three_tasks_are_small(three_tasks):
    for study in (curves.stored(), three_tasks):
        text = json.dumps(shown(study)[1], separators=(",", ":"))
        assert len(text.encode()) < 30 * KILOBYTE


def test_the_curves_claim_is_made_from_the_runs(three_tasks):
    text, _ = shown(three_tasks)
    leads, levels = text["leads"], text["levels"].split(". ")
    assert leads.startswith("GB-DQN-reuse on Acrobot and MountainCar; ")
    assert leads.endswith(" on CartPole") and "reuse" not in leads.split("; ")[1]
    assert [each.split(":")[0] for each in levels] == ["Acrobot", "MountainCar", "CartPole"]
    assert " DQN −" not in levels[0] and " DQN −" in levels[1]
    assert levels[0].startswith("Acrobot: GB-DQN-reuse −99.8 (")


def test_the_curves_answer_is_made_from_the_runs(three_tasks):
    _, frame = shown(three_tasks)
    answers = {task: each["answer"] for task, each in frame["tasks"].items()}
    assert answers["acrobot"]["right"] == "with" and "the better twin" in answers["acrobot"]["why"]
    assert answers["cartpole"]["right"] == "without"
    assert "over DQN-reuse. The boosters cost something." in answers["cartpole"]["why"]
    twins = [three_tasks.difference("mountaincar", "reuse", arm) for arm in curves.TWINS]
    low, high = curves.interval(min(twins, key=stats.iqm))
    says = dict(undecided=low <= 0 <= high)
    says["with"], says["without"] = low > 0, high < 0
    assert says[answers["mountaincar"]["right"]]


def test_a_task_can_be_chosen_if_there_are_several(three_tasks):
    assert shown(three_tasks)[0]["chooser"].count("radio") == 3
    assert curves.chooser(["acrobot"]) == ""


# In a browser


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs Playwright")
    if not CHROMIUM:
        pytest.skip("needs Chromium")
    with sync_api.sync_playwright() as playwright:
        options = dict(executable_path=CHROMIUM, args=["--no-sandbox"])
        browser = playwright.chromium.launch(**options)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory, three_tasks):
    folder = tmp_path_factory.mktemp("figures")
    frames.write(folder)
    three = frames.filled("curves", *curves.figure(three_tasks))
    page = frames.PAGE.format(name="curves", html=three)
    (folder / "curves-three.html").write_text(page, encoding="utf-8")
    for name in PAGES:  # as it is before its script has come
        page = (folder / f"{name}.html").read_text(encoding="utf-8")
        still = re.sub(r"<script defer.*?</script>", "", page)
        (folder / f"{name}-still.html").write_text(still, encoding="utf-8")
    return folder


@pytest.fixture
def open_page(browser, site):
    """open_page(name, width, …): a figure's page from the disk; no error, no request elsewhere."""
    contexts, wrong = [], []

    def open_page(name, width=760, touch=False, **options):
        context = browser.new_context(
            viewport=dict(width=width, height=900), has_touch=touch, **options
        )
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(180_000)  # ms, for a busy machine
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        local = site.as_uri()
        page.on(
            "request", lambda request: request.url.startswith(local) or wrong.append(request.url)
        )
        page.goto(f"{local}/{name}.html")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not wrong


def computed(page, function, argument):
    """What a function of the page returns; as JSON, for Playwright is slow on many numbers."""
    return json.loads(page.evaluate(f"(x) => JSON.stringify(({function})(x))", argument))


def test_the_rooms_agree_with_the_package_at_every_setting(open_page):
    """Six boosts from the drift, for each reading, α and γ; and Q*, residual and policy."""
    page = open_page("rooms")
    for gamma in frames.GAMMAS:
        found = computed(
            page,
            """([gamma, readings, alphas]) => {
              const M = live.rooms, world = M.world(0, gamma);
              const start = M.drift(M.optimum(M.world(9, gamma)), 0);
              return readings.map(([target, loss]) => alphas.map((alpha) => {
                let Q = start;
                return Array.from({ length: 6 }, (_, k) => {
                  if (k) Q = M.boost(world, Q, target, loss, alpha);
                  return [Q, M.residual(world, Q), Q.map((q) => [M.way(q), 0])];
                });
              }));
            }""",
            [gamma, READINGS, ALPHAS],
        )
        for (target, loss), rows in zip(READINGS, found, strict=True):
            for alpha, row in zip(ALPHAS, rows, strict=True):
                mdp, path = instrument.boosted(5, target, loss, alpha, gamma)
                want = [(Q, mdp.residual(Q)) for Q in path]
                got = np.array(row)
                np.testing.assert_allclose(got[:, :2], want, **CLOSE)
                assert (got[:, 2, :, 0] == [instrument.ways(Q) for Q in path]).all()


def test_the_rooms_agree_after_many_drifts(open_page):
    """The goal goes to and fro, and the reading changes on the way."""
    page = open_page("rooms")
    steps = [(k % 2, *READINGS[k % 4], ALPHAS[(3 * k) % 10]) for k in range(1, 13)]
    found = computed(
        page,
        """(steps) => {
          const M = live.rooms;
          let Q = M.drift(M.optimum(M.world(9, 0.9)), 0);
          return steps.map(([end, target, loss, alpha]) => {
            Q = M.boost(M.world(9 * end, 0.9), M.drift(Q, 9 * end), target, loss, alpha);
            return Q;
          });
        }""",
        steps,
    )
    _, Q = instrument.moved()
    for (end, target, loss, alpha), got in zip(steps, found, strict=True):
        Q = Q.copy()
        Q[9 * end] = 0
        Q = instrument.boost(instrument.corridor(9 * end), Q, target, loss, alpha)
        np.testing.assert_allclose(got, Q, **CLOSE)


def test_the_parabola_agrees_with_the_package_at_every_setting(open_page):
    """α of Eq. 8 and the squared residual, for each angle, length and α of the sliders."""
    page = open_page("parabola")
    r, lengths = np.array([1.0, 0.0]), [k / 100 for k in range(75, 151, 5)]
    alphas = [k / 100 for k in range(-300, 301)]
    for angle in range(0, 181, 5):
        found = computed(
            page,
            """([angle, lengths, alphas]) => lengths.map((length) => {
              const M = live.parabola, r = [1, 0], h = M.booster(angle, length);
              return [M.alpha(r, h), ...alphas.map((alpha) => M.loss(r, h, alpha))];
            })""",
            [angle, lengths, alphas],
        )
        for length, (best, *losses) in zip(lengths, found, strict=True):
            h = frames.booster(angle, length)
            assert best == pytest.approx(frames.closed_form_alpha(r, h), rel=0, abs=1e-12)
            np.testing.assert_allclose(losses, frames.squared(alphas, h), **CLOSE)


def test_the_replay_agrees_with_the_package_at_every_setting(open_page):
    """The mass in each bin of age, old and new, for each setting of the five sliders."""
    page, keys = open_page("replay"), ("fresh", "exponent", "q")
    for fresh, exponent, q in itertools.product(*(frames.SLIDERS[key] for key in keys)):
        found = computed(
            page,
            """([fresh, exponent, q, mixes, rates]) => {
              const text = document.querySelector("script[type='application/json']").textContent;
              const data = JSON.parse(text);
              return mixes.map((mix) => rates.map((rate) => {
                const found = live.replay.mass(data, { mix, rate, exponent, fresh, q });
                const [old, fresher] = [0, 1].map((kind) => found.bins.map((bin) => bin[kind]));
                return [...old, ...fresher, found.old];
              }));
            }""",
            [fresh, exponent, q, frames.SLIDERS["mix"], frames.SLIDERS["rate"]],
        )
        np.testing.assert_allclose(found, masses(fresh, exponent, q), **CLOSE)


def test_the_theorem_agrees_with_the_package_at_every_setting(open_page):
    """The residuals at both doors after each booster, with fixed targets and with Q's own."""
    found = computed(
        open_page("theorem"),
        """([gammas, alphas, boosts]) => gammas.map((gamma) => alphas.map((alpha) =>
          live.theorem.boosted(gamma, alpha, boosts).map(({ fixed, own }) => [fixed, own])))""",
        [frames.GAMMAS, ALPHAS, frames.BOOSTS],
    )
    want = [
        [frames.theorem_1.boosted(gamma, alpha, frames.BOOSTS) for alpha in ALPHAS]
        for gamma in frames.GAMMAS
    ]
    np.testing.assert_allclose(found, want, **CLOSE)


def masses(fresh, exponent, q):
    """For each mix and rate: the old mass by bin, the new, and the old share; by the package."""
    replay, rows = frames.aged(exponent, fresh, q), []
    mixes, rates = frames.SLIDERS["mix"], frames.SLIDERS["rate"]
    is_old = np.array(frames.EDGES[:-1]) >= fresh  # a drift is the edge of a bin
    for mix, rate in itertools.product(mixes, rates):
        P = frames.probabilities(replay, mix, rate)
        mass = np.add.reduceat(P, frames.EDGES[:-1])
        rows.append([*mass * is_old, *mass * ~is_old, P[fresh:].sum()])
    return np.reshape(rows, (len(mixes), len(rates), -1))


def test_a_drift_is_the_edge_of_a_bin():
    assert set(frames.SLIDERS["fresh"]) <= set(frames.EDGES)


def test_the_curves_are_drawn_as_they_are_stored(open_page):
    page, study = open_page("curves"), curves.stored()
    found = computed(
        page,
        """() => {
          const text = document.querySelector("script[type='application/json']").textContent;
          return Object.entries(JSON.parse(text).tasks).map(([task, { arms }]) => [task,
            Object.entries(arms).map(([arm, lines]) => [arm, lines.map(live.curves.line)])]);
        }""",
        None,
    )
    assert {task: [arm for arm, _ in drawn] for task, drawn in found} == curves.arms(study)
    for task, drawn in found:
        for arm, lines in drawn:
            assert (np.array(lines) == np.rint(curves.curve(study, task, arm))).all()


# What a reader does


def words(page):
    return page.inner_text("[data-words]")


def press(page, text):
    page.get_by_role("button", name=text, exact=True).click()


def slide(page, key, value):
    """As a keyboard does it, to one end of a slider or by arrows."""
    slider = page.locator(f'[data-key="{key}"]')
    slider.press(value)


def test_the_rooms_tell_ask_and_obey(open_page):
    page = open_page("rooms")
    assert "After 5 boosts, 4 of 9 rooms go the right way" in words(page)
    press(page, "5")
    assert page.inner_text("[data-verdict]").startswith("Not so. It is 9")
    assert "After 1 boost, 9 of 9 rooms" in words(page)
    press(page, "Reset")
    assert "After 0 boosts, 0 of 9 rooms" in words(page)
    assert "In rooms 2 to 8 it is 0, and Q is wrong" in words(page)
    page.get_by_role("radio", name="frozen").check()
    press(page, "Ten boosts")
    assert "After 10 boosts, 9 of 9 rooms" in words(page)
    press(page, "Drift")
    assert words(page).startswith("The goal moved to room 9. After 0 boosts, 0 of 9 rooms")
    slide(page, "room", "End")
    assert "Room 9 is the goal" in page.inner_text("[data-room]")
    page.locator(".names .cell").nth(3).click()
    assert (
        page.locator('[data-key="room"]').get_attribute("aria-valuetext").startswith("3. Left: Q")
    )
    slide(page, "gamma", "Home")
    assert page.locator('[data-key="gamma"]').get_attribute("aria-valuetext") == "0.50"
    assert "After 0 boosts" in words(page)


def test_the_parabola_tells_asks_and_obeys(open_page):
    page = open_page("parabola")
    assert "the best α is A/B = 0.50" in words(page)
    assert "about as much as without the booster" in words(page)
    press(page, "A/B")
    assert "25 % less than without the booster" in words(page).replace("\u00a0", " ")
    press(page, "negative")
    assert page.inner_text("[data-verdict]").startswith("Right. A/B = −0.71")
    slide(page, "alpha", "End")
    assert "With α = 3.00" in words(page)


@pytest.mark.parametrize("touch", [False, True], ids=["mouse", "touch"])
def test_the_booster_can_be_dragged(open_page, touch):
    page = open_page("parabola", touch=touch)
    grip = page.locator(".grip").bounding_box()
    x, y = grip["x"] + grip["width"] / 2, grip["y"] + grip["height"] / 2
    if touch:
        client = page.context.new_cdp_session(page)
        for kind, points in (
            ("touchStart", [dict(x=x, y=y)]),
            ("touchMove", [dict(x=x + 200, y=y + 60)]),
            ("touchEnd", []),
        ):
            client.send("Input.dispatchTouchEvent", dict(type=kind, touchPoints=points))
        touch_start = "new Event('touchstart', {cancelable: true})"
        goes_on = page.locator(".grip").evaluate(f"grip => grip.dispatchEvent({touch_start})")
        assert not goes_on, "the browser may take the swipe for its own, and go back"
    else:
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 200, y + 60, steps=4)
        page.mouse.up()
    assert page.locator('[data-key="length"]').input_value() == "1.5"
    assert int(page.locator('[data-key="angle"]').input_value()) < 30


def test_the_replay_tells_asks_and_obeys(open_page):
    page = open_page("replay")
    said = words(page).replace("\u00a0", " ")
    share = frames.stale(1_000, mix=0.5, rate=1e-2, exponent=0.6, q=10)
    assert f"Old data get {100 * share:.0f} % of the draws" in said
    press(page, "no")
    least = min(
        frames.stale(1_000, mix=0.5, rate=rate, exponent=0.6, q=10)
        for rate in frames.SLIDERS["rate"]
    )
    verdict = page.inner_text("[data-verdict]").replace("\u00a0", " ")
    assert verdict.startswith(f"Right. At best {100 * least:.0f} % are old")
    press(page, "Defaults")
    assert page.locator('[data-key="mix"]').get_attribute("aria-valuetext") == "0.3"
    press(page, "Age")
    assert words(page).startswith("3,000 of the 10,000")
    slide(page, "q", "Home")
    assert "|δ| is 0.0 on old data and 1.0 on new" in words(page)


def test_the_theorem_tells_asks_and_obeys(open_page):
    page = open_page("theorem")
    assert words(page).startswith("After 1 booster the sum of squares is 0.00")
    assert "With its own targets it is 1.62, more than at the start" in words(page)
    press(page, "larger")
    own = frames.squares(**frames.PAPER, boosts=frames.ASKED)[1]
    sums = [frames.squares(**frames.PAPER, boosts=m)[1] for m in range(frames.BOOSTS + 1)]
    said = f"Right. It is {own:.2f}, and rises until booster {np.argmax(sums)}."
    assert page.inner_text("[data-verdict]").startswith(said)
    assert words(page).startswith(f"After {frames.ASKED} boosters")
    press(page, "One boost")
    assert words(page).startswith(f"After {frames.ASKED + 1} boosters")
    press(page, "Reset")
    slide(page, "boosts", "Home")
    assert "it is 1.00, as at the start" in words(page)
    press(page, "The paper’s constants")
    assert page.locator('[data-key="gamma"]').get_attribute("aria-valuetext") == "0.99"


def test_the_curves_tell_ask_and_obey(open_page):
    page, study = open_page("curves"), curves.stored()
    task, *_ = curves.arms(study)
    answer = curves.answer(study, task, curves.arms(study)[task])
    (_, end), *_ = curves.drifted(study.config(task, "reuse"))
    assert words(page).startswith(f"Episode {end - 1}, motor reversed.")
    assert "GB-DQN (paper)" in words(page) and "DQN-reuse, Adam kept" not in words(page)
    press(page, answer["right"])
    assert page.inner_text("[data-verdict]") == f"Right. {answer['why']}"
    assert "DQN-reuse, Adam kept" in words(page) and "GB-DQN (paper)" not in words(page)
    press(page, "Reset")
    assert "GB-DQN (paper)" in words(page) and "DQN-reuse, Adam kept" not in words(page)
    for name in ("GB-DQN-reuse", "GB-DQN (paper)", "DQN"):
        press(page, name)
    assert words(page).endswith("No agent is switched on.")
    press(page, "GB-DQN-reuse")
    slide(page, "episode", "Home")
    first = curves.signed(f"{curves.curve(study, task, 'reuse')[0, 0]:.0f}")
    said = f"Episode {curves.WINDOW - 1}, motor right. Returns, the highest first: GB-DQN-reuse"
    assert words(page) == f"{said} {first}."
    slide(page, "episode", "ArrowRight")
    assert words(page).startswith(f"Episode {curves.WINDOW - 1 + curves.EVERY},")


@pytest.mark.parametrize("touch", [False, True], ids=["mouse", "touch"])
def test_an_episode_can_be_pointed_at(open_page, touch):
    page, study = open_page("curves", touch=touch), curves.stored()
    task, *_ = curves.arms(study)
    box = page.locator("[data-graph]").bounding_box()
    episode = curves.WINDOW - 1 + 20 * curves.EVERY
    x = box["x"] + box["width"] * episode / study.config(task, "reuse").episodes
    y = box["y"] + box["height"] / 2
    (page.touchscreen.tap if touch else page.mouse.move)(x, y)
    assert words(page).startswith(f"Episode {episode},")


def test_the_curves_of_several_tasks(open_page):
    """What is missing cannot be switched on, and the episodes are those of the task."""
    page = open_page("curves-three")
    assert "GB-DQN (paper)" in words(page) and "; DQN " not in words(page)  # Acrobot's is missing
    assert page.get_by_role("button", name="DQN", exact=True).is_disabled()
    page.get_by_role("radio", name="CartPole").check()
    assert page.get_by_role("button", name="DQN-reuse, Adam kept").is_disabled()
    slide(page, "episode", "End")
    assert words(page).startswith("Episode 599, motor right.") and "DQN" in words(page)
    press(page, "without")
    assert page.inner_text("[data-verdict]").startswith("Right. Boosters bring −")
    page.get_by_role("radio", name="Acrobot").check()
    assert page.inner_text("[data-verdict]") == ""
    assert page.locator("[data-guess][aria-pressed]").count() == 0


@every_figure
def test_words_are_said_once_a_drag_ends(open_page, name):
    page = open_page(name)
    page.wait_for_function("document.querySelector('[data-said]').textContent")
    assert page.text_content("[data-said]") == page.text_content("[data-words]")


@pytest.mark.parametrize("name", PAGES)
@every_width
def test_a_figure_never_moves_the_page(open_page, name, width):
    """Its height stays, whatever is pressed or slid, and all its text has room in it."""
    page = open_page(name, width)
    height = page.locator(".live").bounding_box()["height"]
    assert open_page(f"{name}-still", width).locator(".live").bounding_box()["height"] == height
    heights, overflowing = page.evaluate(EVERY_ACT)
    assert set(heights) == {height}
    assert overflowing == []


EVERY_ACT = """() => {
  const all = (kinds) => [...document.querySelectorAll(kinds)], heights = [], overflowing = [];
  const blocks = ".words, .about, .verdict, .predict, .stage, .key, .axis-name";
  const look = () => {
    heights.push(document.querySelector(".live").getBoundingClientRect().height);
    if (document.documentElement.scrollWidth > innerWidth) overflowing.push("page");
    all(blocks).filter((each) =>
      each.scrollHeight > each.clientHeight + 1 || each.scrollWidth > each.clientWidth + 1)
      .forEach((each) => overflowing.push(`${each.className}: ${each.textContent}`));
  };
  const slide = (input, value) => {
    input.value = value;
    input.dispatchEvent(new Event("input"));
    look();
  };
  const press = (each) => { each.click(); look(); };
  all("[type=range]").forEach((each) => { slide(each, each.min); slide(each, each.max); });
  all("[type=radio]").reverse().forEach(press);
  all(".live button").forEach(press);
  return [heights, overflowing];
}"""


@every_figure
def test_without_scripts_there_is_a_picture(open_page, name):
    page = open_page(name, java_script_enabled=False)
    assert page.locator("noscript svg").first.is_visible()
    assert not page.locator(".works").is_visible()


@every_figure
def test_motion_can_be_reduced(open_page, name):
    """Then nothing glides."""
    glides = "[...document.querySelectorAll('.live *')].filter((each) => "
    glides += "getComputedStyle(each).transitionDuration !== '0s').length"
    assert open_page(name, reduced_motion="reduce").evaluate(glides) == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("theme", ["light", "dark", "auto", None])
def test_text_has_contrast(open_page, scheme, theme):
    """At least 4.5 to 1, for the reader's own choice (furo's data-theme) and the system's.

    The figures share one style sheet, so one of them stands for all.
    """
    page = open_page("rooms", color_scheme=scheme)
    if theme:
        page.evaluate("(theme) => { document.body.dataset.theme = theme; }", theme)
    dark = (scheme if theme in ("auto", None) else theme) == "dark"
    ground = colour(page, "--ground")
    assert (luminance(ground) < 0.1) == dark
    for ink in ("--ink", "--soft"):
        assert contrast(colour(page, ink), ground) >= 4.5
    for ink, paper in (("--on-right", "--right"), ("--on-accent", "--accent"), ("--ink", "--pale")):
        assert contrast(colour(page, ink), colour(page, paper)) >= 4.5
    for mark in ("--frozen", "--learner", "--right", "--old", "--new", "--accent", "--line"):
        assert contrast(colour(page, mark), ground) >= 3


def colour(page, name):
    found = f"getComputedStyle(document.querySelector('.live')).getPropertyValue('{name}')"
    text = page.evaluate(found).strip()
    return [int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)]


def luminance(rgb):
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in rgb]
    return np.dot(linear, [0.2126, 0.7152, 0.0722])


def contrast(a, b):
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)
