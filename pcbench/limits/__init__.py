"""Find the maximum allowable delay, sampling period, loss or noise: the largest at which an error stays below a limit.

- `find_limit`: a study's limits of one or two axes, as a table (`pcbench.find_limit`)
- `search`: the search along one axis, which asks for runs and for more seeds where an answer is not certain

What runs at one value say of the limit is in `statistics.limit_verdicts`.
"""
