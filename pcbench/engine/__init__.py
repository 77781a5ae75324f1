"""Thousands of runs at once, faster than the definition in `pcbench.simulation` and equal to it by test.

`runner` takes a layout and jobs, and returns what their runs leave. A program is an `event_loop` over `steps`, which carry the
functions of one run over all lanes, entry by entry (`interpreter`). The flow of affine plants goes by matrix products instead
(`products`) if a study has enough runs.
"""
