"""Simulate thousands of runs at once, faster than the definition in `pcbench.simulation` and tested to be equal to it.

`study.grid.with_engine` decides which engine computes a grid point. `runner` takes a layout and jobs, and returns the sums of
their runs. A *lane* is one run of a vectorized call. A program is an `event_loop` over `steps`, which apply the functions of
one run to all lanes, entry by entry (`interpreter`). `lane_forms` finds the values that differ between lanes, and
`known_entries` the zeros and ones that need no arithmetic. Runs have a common schedule (`common_schedule`) or random ones
(`random_schedules`).
"""
