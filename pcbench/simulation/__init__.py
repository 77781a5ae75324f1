"""Simulate a run tick by tick: its schedule, random numbers and metrics. Plants, observers and controllers are arguments.

- `simulate_runs`: the reference definition of a run; `tick` has the order of events
- `schedule`: the ticks at which samples are taken and arrive
- `rng`, `threefry`: random numbers by seed, stream, channel and sample; `measurements`: measurement noise
- `closed_loop`, `command_network`: from commands to the plant's input
- `metrics`, `innovation_stats`: the sums that a run accumulates; `trajectory`: one run as a table
- `shape_checks`, `controller_shape_checks`: check the shapes that user functions return; `reverse_mode`: runs with a gradient
- `types`: the numbers of a grid point, and the layout that all grid points of a program share
"""
