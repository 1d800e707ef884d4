"""The course as a course: its order, its words, its times, its pictures, its exercises."""

import doctest
import inspect
import re
import subprocess
import sys
from itertools import pairwise, takewhile
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "notebooks"
sys.path.insert(0, str(FOLDER))
with plt.rc_context():  # the look of the lesson's pictures stays there
    import exercises
    import lesson
    import render

CONTENTS = (FOLDER / "README.md").read_text(encoding="utf-8")
COURSE = re.findall(r"^\| \[\d+ · .*?\]\((\d\d_\w+)\.ipynb\)", CONTENTS, re.MULTILINE)
WRITTEN = [name for name in COURSE if (FOLDER / "clean" / f"{name}.ipynb").exists()]
NOTEBOOKS = {name: nbformat.read(FOLDER / f"{name}.ipynb", as_version=4) for name in WRITTEN}
GLOSSARY = re.findall(r"^### (.+)", (ROOT / "docs/glossary.md").read_text("utf-8"), re.MULTILINE)
EXERCISES = exercises.exercises()
MOST_PICTURES, MOST_MINUTES, LEAST_MISTAKES = 40, 30, 5
every_notebook = pytest.mark.parametrize("name", NOTEBOOKS)
every_exercise = pytest.mark.parametrize("name", EXERCISES)


def prose(notebook):
    """The Markdown cells after the title's, without code, equations, links' addresses, headings."""
    cells = [cell.source for cell in notebook.cells[1:] if cell.cell_type == "markdown"]
    text = re.sub(r"^#.*$", "", "\n".join(cells), flags=re.MULTILINE)
    text = re.sub(r"(\[[^\]]*\])\([^)]*\)", r"\1", text)
    return re.sub(r"```.*?```|`[^`\n]*`|\$\$.*?\$\$|\$[^$\n]*\$", "", text, flags=re.DOTALL)


def tags(cell):
    return cell.metadata.get("tags", [])


# The order


def test_the_contents_list_every_notebook_in_order():
    assert len(COURSE) <= 14
    assert [int(name[:2]) for name in COURSE] == list(range(1, len(COURSE) + 1))


@every_notebook
def test_a_page_begins_and_ends_as_all_do(name):
    """Title, time, needs, how to read it; summary, and links to the pages before and after."""
    first, last = NOTEBOOKS[name].cells[0].source, NOTEBOOKS[name].cells[-1].source
    number = int(name[:2])
    assert first.startswith(f"# {number} · ")
    assert re.search(r"\*Time: \d+ minutes\.\s", first)
    assert "\n\n**How to read this with the paper open.** " in first and "\n## " not in first
    assert "paper open" not in "".join(cell.source for cell in NOTEBOOKS[name].cells[1:])
    assert last.startswith("## Summary")
    links = ["[contents](README.md)"]
    if number > 1:
        links.insert(0, f"[← {number - 1}]({COURSE[number - 2]}.ipynb)")
    if number < len(COURSE):
        links.append(f"[{number + 1} →]({COURSE[number]}.ipynb)")
    assert last.splitlines()[-1] == " · ".join(links)


@every_notebook
def test_its_time_is_honest_and_short(name):
    stated = int(re.search(r"\*Time: (\d+) minutes", NOTEBOOKS[name].cells[0].source)[1])
    assert abs(stated - lesson.minutes(NOTEBOOKS[name])) <= 1
    assert stated <= MOST_MINUTES


def test_the_minutes_of_a_page():
    """200 words, 15 lines, an equation, a picture: a minute each; what is folded is free."""
    new = nbformat.v4
    words = new.new_markdown_cell("word " * 200 + "$$x$$\n<details>" + "word " * 200 + "</details>")
    picture = new.new_output("display_data", {"image/png": "", "text/plain": "a picture"})
    code = new.new_code_cell("x = 1\n" * 15, outputs=[picture])
    assert lesson.minutes(new.new_notebook(cells=[words, code])) == 4
    listing = new.new_output("display_data", {"text/markdown": "```python\n" + "x\n" * 15 + "```"})
    code = new.new_code_cell("source(f)", outputs=[listing])
    assert lesson.minutes(new.new_notebook(cells=[code])) == 2


@pytest.mark.parametrize("name", WRITTEN)
def test_no_line_is_over_88_columns(name):
    """Of code or Markdown, but rows of tables, which cannot be broken."""
    lines = (FOLDER / f"{name}.py").read_text(encoding="utf-8").splitlines()
    lines = [line.removeprefix("# ") for line in lines if not line.startswith("# |")]
    assert not [line for line in lines if len(line) > 88]


@every_notebook
def test_the_copy_without_outputs_is_current(name):
    copy = nbformat.read(FOLDER / "clean" / f"{name}.ipynb", as_version=4)
    assert copy == render.clean(NOTEBOOKS[name])
    assert not any(cell.get("outputs") for cell in copy.cells)


# The words


def uses(term, text):
    """Where a term stands in a text, in the singular or the plural, but not within a longer one,
    such as network in target network.
    """
    text = text.replace("\n", " ")
    for longer in GLOSSARY:
        if term != longer and re.search(rf"\b{term}\b", longer, re.IGNORECASE):
            text = pattern(longer).sub(lambda found: "·" * len(found[0]), text)
    return [found.start() for found in pattern(term).finditer(text)]


def pattern(term):
    stem = term[:-1] + "(?:y|ies)" if term.endswith("y") else term + "(?:e?s)?"
    return re.compile(rf"\b{stem}\b", 0 if len(term) == 1 else re.IGNORECASE)


@pytest.mark.parametrize("term", GLOSSARY)
def test_a_term_is_first_used_where_it_is_defined(term):
    """There it stands in bold."""
    pages = takewhile(NOTEBOOKS.__contains__, COURSE)  # while pages are missing: those before
    text = "\n".join(prose(NOTEBOOKS[name]) for name in pages)
    found = uses(term, text)
    if found:
        start = found[0]
        assert text[start - 2 : start] == "**", text[max(start - 60, 0) : start + 40]
    else:
        assert len(NOTEBOOKS) < len(COURSE), "in no notebook"


def test_the_glossary_is_in_alphabetical_order_and_complete():
    assert sorted(GLOSSARY, key=str.lower) == GLOSSARY
    asked = """state, action, return, policy, discount, Q, TD error, residual, target network,
        bootstrap, replay, priority, importance weight, contraction, sup norm, drift, regime,
        forgetting, network, weight, parameter, hidden unit, gradient, loss, batch, Adam,
        learning curve, control, variance, paired difference"""
    assert set(re.split(r",\s+", asked)) <= set(GLOSSARY)


# What is guessed first


@every_notebook
def test_a_prediction_is_asked_before_its_answer_is_seen(name):
    """The answer is folded, or it is the output of a cell tagged predicted, which is hidden.

    So is its code if it asserts the answer or has its picture's alt text.
    """
    cells = NOTEBOOKS[name].cells
    asked = [k for k, cell in enumerate(cells) if "> **Predict" in cell.source]
    for k, end in pairwise([*asked, len(cells)]):
        folded = "<details>" in cells[k].source.split("> **Predict")[-1]
        assert folded or any("predicted" in tags(cell) for cell in cells[k:end]), cells[k].source
    for cell in cells:
        if "predicted" in tags(cell):
            assert cell.metadata["jupyter"]["outputs_hidden"]
            told = bool(re.search(r"\bassert\b|\balt=|\bshow\(", cell.source))
            assert cell.metadata["jupyter"].get("source_hidden", False) == told
        elif "checks" in tags(cell):
            assert cell.metadata["jupyter"]["source_hidden"]


# The pictures


def pictures(notebook):
    """(data, metadata) of every picture."""
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if any(kind.startswith("image/") for kind in output.get("data", {})):
                yield output["data"], output["metadata"]


def test_there_are_few_pictures():
    assert sum(len(list(pictures(notebook))) for notebook in NOTEBOOKS.values()) <= MOST_PICTURES


@every_notebook
def test_every_picture_has_an_alt_text(name):
    for data, metadata in pictures(NOTEBOOKS[name]):
        (kind,) = (kind for kind in data if kind.startswith("image/"))
        assert len(metadata[kind]["alt"].split()) >= 8
        if kind == "image/svg+xml":
            assert "<title>" in "".join(data[kind])


def test_a_picture_repeats_byte_by_byte_and_small_text_is_refused():
    def draw(size=9):
        figure, axis = plt.subplots()
        axis.plot([0, 1], label="a line")
        axis.legend(fontsize=size)
        return figure

    with plt.rc_context({"svg.hashsalt": "gbdqn_ref"}):
        first, second = draw(), draw()
        assert lesson.svg(first, "a < b") == lesson.svg(second, "a < b")
        assert "<title>a &lt; b</title>" in lesson.svg(first, "a < b")
    with pytest.raises(ValueError, match="8 pt"):
        lesson.show(draw(8), "too small to read")
    plt.close("all")


# The exercises


@pytest.mark.parametrize("module", [lesson, render, exercises], ids=lambda module: module.__name__)
def test_the_examples_in_docstrings(module):
    """pytest looks for them elsewhere only."""
    found = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted and not found.failed


@every_exercise
def test_the_solution_is_right(name):
    assert exercises.judge(EXERCISES[name], EXERCISES[name].solution) == "right."


@every_exercise
def test_every_likely_mistake_is_named(name, capsys):
    """By its own sentence, with a case, and the page goes on with the solution."""
    exercise = EXERCISES[name]
    assert len(exercise.mistakes) >= LEAST_MISTAKES
    for sentence, mistake in exercise.mistakes.items():
        verdict = exercises.judge(exercise, mistake)
        assert verdict.startswith(sentence), (sentence, verdict)
        assert exercises.check(name, mistake) is exercise.solution
        assert sentence in capsys.readouterr().out


@every_exercise
def test_stubs_and_attempts_that_raise_are_answered(name):
    exercise = EXERCISES[name]
    stub = "not written yet. Hint: "
    assert exercises.judge(exercise, lambda *_: None).startswith(stub)
    assert exercises.judge(exercise, lambda *_: ...).startswith(stub)
    wrong = exercises.judge(exercise, lambda *_: 1 / 0)
    assert "raises ZeroDivisionError" in wrong
    for nonsense in ("no function", {}, lambda *_: "text", lambda *_: [[1], [2, 3]]):
        assert exercises.judge(exercise, nonsense) != "right."


def in_place(name):
    """A function for that exercise, right but for what it does to its first array."""

    def boost(frozen, goal, alpha):
        frozen += EXERCISES["boost"].solution(frozen, goal, alpha) - frozen
        return frozen

    def target(reward, terminated, q_next, gamma):
        q_next.sort()
        return reward if terminated else reward + gamma * q_next[-1]

    def discounted(*arguments):
        arguments[0].reverse()
        return EXERCISES["discounted"].solution(arguments[0][::-1], arguments[1])

    return locals()[name]


@pytest.mark.parametrize(
    ("name", "changed"), [("boost", "frozen"), ("target", "q_next"), ("discounted", "arguments")]
)
def test_an_attempt_that_changes_its_arguments_is_told_so(name, changed):
    verdict = exercises.judge(EXERCISES[name], in_place(name))
    assert verdict == f"the result is right, but `{changed}` has changed: work on a copy."


def test_an_attempt_that_forgets_to_return_is_told_so():
    def target(reward, terminated, q_next, gamma):
        y = reward if terminated else reward + gamma * q_next.max()  # noqa: F841

    class Boosted(EXERCISES["Boosted"].solution):
        def q(self):
            self.frozen + self.h

    for attempt, it in ((target, "it"), (Boosted, "q()")):
        verdict = exercises.judge(EXERCISES[attempt.__name__], attempt)
        assert verdict == f"{it} returns None: return the result."


def test_an_update_that_leaves_q_alone_is_not_taken_for_a_stub():
    def update(Q, room, action, y, rate):
        Q[room, action] + rate * (y - Q[room, action])

    assert exercises.judge(EXERCISES["update"], update).startswith("Q itself does not change")


@pytest.mark.parametrize("name", WRITTEN)
def test_a_page_has_exercises_and_each_exists(name):
    text = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    checked = re.findall(r'\bcheck\(\s*"(\w+)"', text)
    assert 1 <= len(checked) <= 6
    assert set(checked) <= set(EXERCISES)
    assert set(checked) == set(re.findall(r'\bsolution\(\s*"(\w+)"', text))


def test_no_two_exercises_have_the_same_name():
    """The later one would hide the earlier."""
    files = (FOLDER / "exercises").glob("*.py")
    assert sum(file.read_text("utf-8").count("\n    Exercise(\n") for file in files) == len(
        EXERCISES
    )


# The world


@pytest.mark.parametrize("goal", range(lesson.ROOMS))
def test_the_corridor_is_one_world(goal):
    """As steps and as an MDP; at the goal nothing comes any more."""
    mdp = lesson.corridor(goal)
    for room, action in np.ndindex(lesson.ROOMS, 2):
        if room != goal:
            room2, reward, terminated = lesson.step(room, action, goal)
            assert mdp.P[room, action, room2] == 1 and mdp.r[room, action] == reward
            assert terminated == (room2 == goal)
    assert (mdp.q_star()[goal] == 0).all()


# The reader's forty lines


def test_the_forty_lines_are_what_the_notebooks_show():
    """One file with the code of notebooks 1 and 2 and the solution between them."""
    file = (FOLDER / "forty_lines.py").read_text(encoding="utf-8")
    parts = dict(re.findall(r"^(?:class|def) (\w+).*?:\n((?:    .*\n|\n)+)", file, re.MULTILINE))
    assert set(parts) == {"step", "Boosted", "train"}
    for name, part in (("01_ten_rooms", "step"), ("02_forty_lines", "train")):
        assert parts[part].rstrip() in (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    assert inspect.getsource(EXERCISES["Boosted"].solution).endswith(
        parts["Boosted"].rstrip() + "\n"
    )


def test_the_forty_lines_run_and_are_forty():
    """Without blank lines, comments, docstrings and the last part, which prints."""
    path = FOLDER / "forty_lines.py"
    code = path.read_text(encoding="utf-8").split("if __name__")[0]
    assert len(re.findall(r'^(?! *(?:#|""")).*\S', code, re.MULTILINE)) <= 40
    ran = subprocess.run([sys.executable, path], capture_output=True, text=True, check=True)
    counts = [int(line.split(": ")[1].split()[0]) for line in ran.stdout.splitlines()]
    assert counts == [9, 9, 0]


# The links


def test_ids_in_prose_become_links_and_nothing_else_does():
    text = "T1-a, D6; `T1-a`, $B1$, [M1](x.md), Z9\n```\nC1\n```"
    known = "[T1-a](../paper_checks/README.md#t1-a), [D6](../paper_checks/README.md#d6)"
    assert render.linked(text) == text.replace("T1-a, D6", known, 1)


@every_notebook
@pytest.mark.parametrize("folder", [".", "clean"])
def test_every_link_to_a_file_leads_somewhere(name, folder):
    """A page of the course that is not written yet is known from the contents."""
    cells = nbformat.read(FOLDER / folder / f"{name}.ipynb", as_version=4).cells
    text = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    ledger = (ROOT / "paper_checks/README.md").read_text(encoding="utf-8")
    for address in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        planned = address.removesuffix(".ipynb") in COURSE
        assert planned or (FOLDER / folder / address).exists(), address
    for anchor in re.findall(r"paper_checks/README\.md#([^)]+)\)", text):
        assert f'<a id="{anchor}"></a>' in ledger
