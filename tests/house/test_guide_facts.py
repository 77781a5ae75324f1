"""Lists on the guide's pages are those of the code: who has a covariance, who takes which clocks, whose gains are proven."""

import re

import pytest
from documents import PAGES, prose
from reference_pages import certificates

from pcbench import plots
from pcbench.checking import observer
from pcbench.cli import commands
from pcbench.engine import runner
from pcbench.fields import FIELDS
from pcbench.observers import OBSERVERS
from pcbench.protocols import Observer
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES


def code_words(page, begin):
    """What stands in code in the sentence of a page that begins so, on whatever lines."""
    (sentence,) = re.findall(rf"{re.escape(begin)}(.*?)[.:;](?:\s|$)", re.sub(r"\s+", " ", PAGES[page]))
    return re.findall(r"`([^`]+)`", sentence)


def observers(holds):
    return {name for name, entry in OBSERVERS.items() if holds(entry)}


@pytest.mark.parametrize(
    ("page", "begin", "holds"),
    [
        ("limitations.md", "Channels may have different sampling times with", lambda e: e.takes == "any schedule"),
        (
            "limitations.md",
            "Channels may have different constant delays also with",
            lambda e: e.takes == "constant delays",
        ),
        ("limitations.md", "Only open loops are supported by", lambda e: not e.loops),
        ("consistency.md", "These observers report an interval:", lambda e: e.observer.bounds),
        ("consistency.md", "These observers report a covariance:", lambda e: e.observer.covariance),
        (
            "consistency.md",
            "These observers report no `nis`:",
            lambda e: e.observer.covariance and not e.observer.innovation,
        ),
    ],
)
def test_the_observers_that_a_sentence_names_are_all_of_them(page, begin, holds):
    assert sorted(code_words(page, begin)) == sorted(observers(holds))


def test_the_observers_whose_gains_nothing_proves_are_all_of_them():
    unproven = [name for name, proof in certificates().items() if proof.startswith("no,")]
    assert sorted(code_words("limitations.md", "There is no certificate for")) == sorted(unproven)


MISSING = re.compile(  # what says that something is missing
    r"\bnot supported\b|\bcannot\b|\bno\b.*\byet\b|\bdo(?:es)? not (?:support|have|read|write|export|accept|take)\b"
    r"|\b(?:takes?|exports?|reads?|writes?|supports?|offers?) no\b|\black(?:s|ing)?\b|^there (?:is|are) no\b|^no\b",
    re.IGNORECASE,
)
FEATURES = {  # what exists, and the words by which a page would name it
    "replay": r"recording|recorded|\blogs?\b|\bbags?\b|smooth",
    "export": r"\bexport|\bC code\b",
    "external run": r"languages?\b",
    "tune": r"\btun(?:e|es|ed|ing)\b",
    "find-limit": r"maximum (?:allowable )?delay",
    "info": r"MCAP|ULog|MAT-file|rosbag",
    "ukf": r"unscented|cubature|sigma.point",
    "particle": r"particle",
    "mhe": r"moving.horizon",
    "smo": r"sliding.mode",
    "high-gain": r"high.gain",
    "oosm-a1": r"retrodict|out-of-sequence",
    "kf-cloning": r"cloning",
    "student_t_dof": r"Student's t|outliers?",
    "command_loss": r"commands",
    "parameter_drift": r"\bdrift",
    "try_once_discard": r"\bprotocols?\b",
    "processor_speed": r"execution times?|\bprocessors?\b",
}
REVIEWED = {  # sentences that name what exists and are right
    "*pcbench lacks:* several objects, data association, tuning on a recorded truth.": "tunes on recordings by likelihood",
    "There is no certificate for": "a test above compares the list",
    "*pcbench lacks:* schedulers, several tasks on one processor, network protocols other than": "two are built in",
    "Several tasks on one processor are not supported.": "each observer has a processor of its own",
}


def claims(text):
    """The sentences of a page that call something missing, each with the names of existing things in it."""
    names = {*commands.ALL, *OBSERVERS, *(f.name for f in FIELDS)}
    for block in re.split(r"\n\s*\n|\n\s*[-*] |\n#+ |\||(?=\*pcbench lacks)|(?=\*It adds)", prose(text)):
        for sentence in re.split(r"(?<=[.;])\s+", " ".join(block.split())):
            if MISSING.search(sentence):
                words = {name for name, pattern in FEATURES.items() if re.search(pattern, sentence, re.IGNORECASE)}
                yield sentence, words | names & set(re.findall(r"`(?:pcbench )?([^`]+)`", sentence))


@pytest.mark.parametrize("page", ["limitations.md", "comparison.md"])
def test_page_calls_nothing_missing_that_exists(page):
    wrong = {sentence: there for sentence, there in claims(PAGES[page]) if there}
    assert {sentence: there for sentence, there in wrong.items() if not sentence.startswith(tuple(REVIEWED))} == {}


def test_features_exist_and_reviewed_sentences_are_on_a_page():
    assert FEATURES.keys() <= {*commands.ALL, *OBSERVERS, *(f.name for f in FIELDS)}
    shown = [sentence for page in ("limitations.md", "comparison.md") for sentence, _ in claims(PAGES[page])]
    assert all(any(sentence.startswith(begin) for sentence in shown) for begin in REVIEWED)


@pytest.mark.parametrize(
    ("text", "there"),
    [
        ("pcbench takes no log.", {"replay"}),
        ("It exports no observer to C.", {"export"}),
        ("`particle` is not supported.", {"particle"}),
        ("The axis `loss` cannot be varied.", {"loss"}),
        ("There is no smoothing.", {"replay"}),
        ("*pcbench lacks:* tuning on data, other languages.", {"tune", "external run"}),
        ("There is no `pcbench find-limit` yet.", {"find-limit"}),
        ("*pcbench lacks:* network protocols, tasks with execution times.", {"try_once_discard", "processor_speed"}),
    ],
)
def test_wrong_claims_are_found(text, there):
    assert [names for _, names in claims(f"# Title\n\n{text}\n")] == [there]


def test_comparison_counts_observers():
    assert f"| pcbench | {len(OBSERVERS)} observers |" in PAGES["comparison.md"]


def test_every_check_of_an_observer_is_named():
    assert code_words("your_own_observer.md", "`check` tests") == [*observer.CHECKS, "closed loop"]


def test_every_optional_function_of_an_observer_is_named():
    optional = [name for name, default in Observer._field_defaults.items() if default is None]
    assert f"{ {7: 'Seven'}[len(optional)] } functions are optional" in PAGES["your_own_observer.md"]
    section = PAGES["your_own_observer.md"].split("## Optional functions")[1].split("\n## ")[0]
    for name in optional:
        assert re.search(rf"`{name}[(`]", section), name


def test_every_plot_is_named():
    page = PAGES["paper.md"].split("## Figures in Python")[1].split("\n## ")[0]
    for name in plots.__all__:
        assert re.search(rf"(?:plots\.|`){name}\b", page) or name == "styles", name


def test_widths_of_journals_are_those_of_the_page():
    widths = {
        name: [f"{72.27 * w:.0f} pt ({w:.2f} in)" for w in (paper.width, paper.full)]
        for name, paper in plots.JOURNALS.items()
    }
    rows = re.findall(r"^\| `(\w.*?)` \| [^|]* \| ([^|]+) \| ([^|]+) \|$", PAGES["paper.md"], re.M)
    assert {name: [*each] for name, *each in rows} == widths


def test_how_many_runs_a_call_has():
    widths = sorted({*runner.NARROW_WIDTHS, runner.WIDTH})
    assert "an array over {}, {} or {} runs".format(*widths) in " ".join(PAGES["how_it_works.md"].split())


def test_how_many_scenarios_of_the_cart_the_study_has():
    cart = [name for name in SCENARIOS if name.startswith("cart/")]
    words = {6: "six", 10: "ten"}
    said = f"{words[len(STUDIES['cart'].scenarios)]} of the {words[len(cart)]} scenarios on the cart"
    assert said in PAGES["quickstart.md"]
