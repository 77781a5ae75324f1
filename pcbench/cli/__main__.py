"""Run the command line: python -m pcbench.cli."""

from pcbench.cli import main

main()
