"""Every block of the guide, the README and CONTRIBUTING is of a kind that is known, and runs in the order of its page."""

import re

import pytest
from documents import RUN, code_blocks, commands
from walked import AS_USERS_HAVE_IT, EVERY_STUDY, shared_runs, walk
from whole_studies import require_whole, run_studies

LANGUAGES = ("sh", "python", "toml", "text", "c")
NOT_RUN = [  # every block that no test runs, with the reason that its page gives
    ("README.md", "sh", ".ci/run runs it in a clean environment"),
    ("README.md", "sh", ".ci/run runs it in a clean environment"),
    ("export_to_c.md", "sh", "the estimates are of another program"),
    ("five_papers.md", "sh", "minutes; tests/reproduce runs paper by paper"),
    ("large_studies.md", "sh", "needs a Dask scheduler on another machine"),
    ("large_studies.md", "python", "needs a cluster under SLURM"),
    ("large_studies.md", "sh", "needs a cluster under SLURM"),
    ("the_field.md", "sh", "minutes; a test computes its examples one by one"),
    ("CONTRIBUTING.md", "sh", "what .ci/run does, in an hour"),
]
SAVED = re.compile(r"\b[Ss]ave\s+(?:\w+\s+)?as\s+`([\w.-]+)`")


@pytest.mark.parametrize("name", RUN)
def test_every_block_says_what_it_is_written_in(name):
    fences = re.findall(r"^.*(?:```|~~~).*$", RUN[name], re.M)
    assert all(re.fullmatch(r"```", fence) for fence in fences[1::2])
    for fence in fences[::2]:
        assert re.fullmatch(rf'```(?:{"|".join(LANGUAGES)})(?: title="[\w.-]+")?', fence), fence
    assert len(code_blocks(name)) == len(fences) / 2


def test_the_blocks_that_are_not_run_are_these():
    assert [(name, b.language, b.reason) for name in RUN for b in code_blocks(name) if b.reason is not None] == NOT_RUN
    assert sum(len(re.findall(r"<!-- *not run", text)) for text in RUN.values()) == len(NOT_RUN)


def test_a_remark_that_a_block_is_not_run_stands_at_one_that_would_be():
    for name in RUN:
        for block in code_blocks(name):
            assert block.reason is None or (block.language in ("sh", "python") and block.reason)


def test_what_a_page_says_to_save_has_that_name():
    found = [(name, file) for name, text in RUN.items() for file in SAVED.findall(text)]
    assert len(found) > 8
    for name, file in found:
        assert file in [block.title for block in code_blocks(name)], (name, file)


def test_runs_that_are_left_out_are_those_of_the_page_of_every_study():
    """It runs them as a user has them."""
    found = [(name, line) for name in RUN for line in shared_runs(name)]
    assert found == [
        ("gains.md", "pcbench run equal-tuning"),
        ("unknown_inputs.md", "pcbench run unknown-input"),
    ]
    assert {line for _, line in found} < set(commands(EVERY_STUDY))
    assert EVERY_STUDY in AS_USERS_HAVE_IT


def test_the_readme_runs_its_python_alone():
    assert [b.language for b in code_blocks("README.md") if b.reason is None and b.language != "text"] == [
        "python",
        "toml",
    ]


def runs(name):
    return any(block.reason is None and block.language in ("sh", "python") for block in code_blocks(name))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in AS_USERS_HAVE_IT else pytest.mark.ci)
        for name in RUN
        if runs(name) and name != "README.md"  # its Python: test_readme
    ],
)
def test_every_block_runs(name, tmp_path):
    for done in walk(name, tmp_path):
        assert done.code == 0, (done.what, done.out[-300:], done.err[-900:])
    for study, folder in run_studies(name).items():
        require_whole(study, tmp_path / folder)
