"""The commands for a paper: tables of a result, and what to cite."""

from pathlib import Path
from typing import Annotated

import typer

from pcbench.cli.shared import RANKS, Folder, Metric, Signals, chosen, out, write
from pcbench.errors import UserError, printable

SUFFIXES = {".tex": "latex", ".md": "markdown", ".csv": "csv"}


def tables(
    folder: Folder,
    latex: Annotated[bool, typer.Option("--latex", help="LaTeX, for booktabs and siunitx")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Markdown [default, or what --out ends in]")] = False,
    csv: Annotated[bool, typer.Option("--csv", help="a row an estimate, its numbers in full")] = False,
    plain: Annotated[bool, typer.Option("--plain", help="LaTeX without any package")] = False,
    metric: Metric = RANKS,
    signal: Signals = None,
    file: Annotated[str | None, out("file to write, .tex, .md or .csv [default: the terminal]")] = None,
) -> None:
    """Print the tables of a study's results as a paper has them: means with intervals, the best marked with how surely.

    Example: pcbench tables results/quick --latex --signal all --out tables.tex
    """
    form = _form({"latex": latex or plain, "markdown": markdown, "csv": csv}, file)
    from pcbench.dataset.result import open_result
    from pcbench.tables import latex as tex
    from pcbench.tables import layout, text

    found = layout.tables(open_result(folder), metric, chosen(signal))
    if not found:
        raise UserError(f"--metric: got {metric}, which the signals asked for do not have; take another.")
    said = {
        "latex": lambda: tex.latex(found, plain),
        "markdown": lambda: text.markdown(found),
        "csv": lambda: text.values(found),
    }
    _put(said[form](), file)


def _form(asked: dict[str, bool], file: str | None) -> str:
    """The form that is asked for: by its option, or else by the file's name."""
    named = [form for form, yes in asked.items() if yes]
    suffix = Path(file).suffix.lower() if file else ".md"
    if len(named) > 1:
        raise UserError(f"tables: got --{' and --'.join(named)}, expected one form; leave the others out.")
    if not named and suffix not in SUFFIXES:
        raise UserError(
            f"--out {file}: got no form by its name, expected one of {', '.join(SUFFIXES)}; say --latex or so."
        )
    return named[0] if named else SUFFIXES[suffix]


def _put(content: str, file: str | None) -> None:
    """Print a text, or write it into a file, what cannot be printed as its escape."""
    content = printable(content, but="\n")
    if file is None:
        write(content)
        return
    try:
        Path(file).write_text(content, encoding="utf-8")
    except OSError as error:
        raise UserError(
            f"--out {file}: cannot be written ({error.strerror}), expected a place for it; mend that."
        ) from None
    print(file)


def cite(
    what: Annotated[
        str | None,
        typer.Argument(metavar="[DIR|STUDY]", help="a folder that pcbench run has made, or a study [default: all]"),
    ] = None,
    file: Annotated[str | None, out("file to write [default: the terminal]")] = None,
) -> None:
    """Print BibTeX of what a study used: its observers' and scenarios' papers, the solvers, the libraries, and pcbench.

    Example: pcbench cite results/quick --out quick.bib
    """
    from pcbench import citing

    _put(citing.bibtex(what), file)
