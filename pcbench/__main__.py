"""Run the command line: python -m pcbench."""

from pcbench.cli import program

program()
