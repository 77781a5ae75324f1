"""Find the maximum allowable delay, sampling period, loss or noise: the largest value at which an error stays below a limit.

- `find_limit`: a study's limits of one or two axes, as a table (`pcbench.find_limit`)
- `search`: the search along one axis, which requests runs, and more seeds if an answer is undecided

`statistics.limit_verdicts` evaluates the runs at one value.
"""
