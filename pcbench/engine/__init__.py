"""Thousands of runs at once, faster than the definition in `pcbench.simulation` and equal to it by test.

Which engine computes a grid point is decided when a study is planned (`study.grid.with_engine`), not here. `runner` takes a
layout and jobs, and returns what their runs leave. A program is an `event_loop` over `steps`, which carry the functions of one
run over all lanes, entry by entry (`interpreter`; `lane_forms` reads from a program what differs between lanes), on schedules
that runs share (`common_schedule`) or do not (`random_schedules`).
"""
